"""How long the history is kept; only `migrate` writes it.

The database itself prunes by it, once an hour (sql/0010_control_views.sql).
"""

from robotether_server.db.database import Transaction


def set_days(tx: Transaction, days: int) -> None:
    """Keep audit log, drives and sessions for so many days; 0 is for ever."""
    tx.change(
        "INSERT INTO retention (id, days) VALUES (1, %s) ON DUPLICATE KEY UPDATE days = VALUES(days)",
        (days,),
    )
