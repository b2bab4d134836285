"""Texts in the database are what Python takes them for: no blank is overlooked, and no case."""

import pytest
from robotether_server.db import robots, users
from robotether_server.db.audit import AuditSearch, Source, find, record
from robotether_server.db.grants import GROUPS, SITES
from robotether_server.problems import RecordMissingError, RobotUnknownError


def test_no_column_is_compared_past_blanks_or_case(admin_database):
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


def test_name_with_a_blank_or_in_other_case_is_another_name(database):
    """Nobody is found by it whom rules in Python, which compare names as they are, would not know."""
    with database.transaction() as tx:
        users.add(tx, "x", "hash", "admin")
        robots.add(tx, "02:00:00:00:00:01", "x")
        SITES.add(tx, "x")
        GROUPS.add(tx, "x")
        for look_up in (users.get, robots.get, SITES.get, GROUPS.get):
            assert look_up(tx, "x") is not None
            for name in ("x ", "X", "x\t", "x\0"):
                with pytest.raises((RecordMissingError, RobotUnknownError)):
                    look_up(tx, name)


def test_audit_log_tells_names_with_blanks_apart(database):
    """What somebody claimed to be called is not what an admin is called."""
    with database.transaction() as tx:
        record(tx, Source("root "), "login_failed")
        assert find(tx, AuditSearch(actor="root")) == []
        assert len(find(tx, AuditSearch(actor="root "))) == 1
