"""Makes all enrolments take turns: joins, and what admins do to robots' rows and keys.

A join decides by several rows at once: whose the MAC is, whether another row or a claim has the key, how many
wait, which name is free. Row locks in changing order would end some of those who join at the same moment with
a deadlock; with this lock each finds what the one before it left. Who needs it takes it first, before any row.
"""

from robotether_server.db.database import Transaction
from robotether_server.problems import StoreUnavailable

# A turn takes milliseconds. Who waits holds one of web's few threads, which the pages need too.
WAIT_S = 3


def enrolment(tx: Transaction) -> None:
    """Hold the lock until the transaction's connection closes, after its commit. Raises StoreUnavailable."""
    row = tx.row("SELECT GET_LOCK('robotether.enrolment', %s) AS held", (WAIT_S,))
    if not row or row["held"] != 1:
        raise StoreUnavailable(
            f"cannot change robots: other changes have been running for {WAIT_S} s; try again shortly"
        )
