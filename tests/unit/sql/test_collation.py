"""Texts in the database are what Python takes them for: no blank is overlooked, and no case."""


def test_no_column_is_compared_past_blanks_or_case(admin_database):
    """Nobody is found by a name that rules in Python, which compare names as they are, would not know."""
    with admin_database.transaction() as tx:
        rows = tx.rows(
            "SELECT c.table_name AS place, c.column_name AS name, c.collation_name AS collation "
            "FROM information_schema.columns c JOIN information_schema.tables t USING (table_schema, table_name) "
            "WHERE c.table_schema = DATABASE() AND t.table_type = 'BASE TABLE' "
            "AND c.collation_name <> 'utf8mb4_nopad_bin'"
        )
        new = tx.row("SELECT @@collation_database AS collation")
    assert not rows
    assert new == {"collation": "utf8mb4_nopad_bin"}
