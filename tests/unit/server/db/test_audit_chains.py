"""The chains of the audit log in the real database, whose trigger writes them."""

import datetime as dt
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import pytest
from robotether_common.audit_head import NAMESPACE, statement
from robotether_server import audit_chain
from robotether_server.db import audit, audit_chains, fleet, robots
from robotether_server.db import migrate as migrations
from robotether_server.db.audit import Source
from robotether_server.db.fleet import AuditEntry
from robotether_server.problems import StoreUnavailableError

NOON = dt.datetime(2026, 1, 1, 12, 0, tzinfo=dt.UTC)
KEY = audit_chain.server_key("x" * 32)


def reports(database):
    with database.transaction() as tx:
        return {report.chain: report for report in audit_chain.check(audit_chains.read_chains(tx))}


def record(database, actor="ann", robot="sim1", **details):
    with database.transaction() as tx:
        audit.record(tx, Source(actor, "192.0.2.1"), "login", robot, **details)


def sign(tx, chain, position):
    """Sign a line as a relay does."""
    (line,) = audit_chains.read_lines(tx, chain, position - 1, 1)
    text = statement(chain, position, line.hash, None)
    tx.change(
        "INSERT INTO audit_heads (chain, position, hash, signer, public_key, signature) "
        "VALUES (%s, %s, UNHEX(%s), 'server', %s, %s)",
        (chain, position, line.hash, KEY.public_key, KEY.sign(NAMESPACE, text)),
    )


def test_every_writer_extends_the_chain_of_its_robot(database, relay_database, admin_database):
    """Web, relay and procedures write texts of any kind; the hash is that of the reference, whatever the time zone."""
    with database.transaction() as tx:
        number = robots.add(tx, "02:00:00:00:00:01", "sim1")
        robots.set_state(tx, number, "active")
        for actor in ("é" * 70, "ann\nroot", "", "1:a", "😀\0"):
            audit.record(tx, Source(actor), "login_failed", note="a\nb\\")
        tx.change("SET time_zone = '-05:00'")
        audit.record(tx, Source("ann"), "login", "sim1")
        tx.change("SET time_zone = '+00:00'")
    with relay_database.transaction() as tx:
        fleet.write(tx, [AuditEntry(NOON, "ann", "drive_started", "sim1", None, {"fence": 1})])
        fleet.ask_for_help(tx, number, source="robot", reason="stück\n", priority=2, pool="")
    with admin_database.transaction() as tx:
        tx.change("CALL record_refused_key('SHA256:a', '192.0.2.1')")
        tx.change("CALL record_refused_key('SHA256:a', '192.0.2.1')")
    found = reports(database)
    assert {chain: report.lines for chain, report in found.items()} == {"": 5, "sim1": 3}
    assert not [report.fault for report in found.values() if report.fault]


def test_writers_at_once_make_one_chain_each(database, relay_database):
    """Of those who wait for each other crosswise the database lets one try again."""

    def write(number):
        names = ["a", "b"][:: 1 if number % 3 else -1]
        if number % 2:
            with relay_database.transaction() as tx:
                for name in names:
                    fleet.write(tx, [AuditEntry(NOON, f"u{number}", "login", name)])
            return
        with database.transaction() as tx:
            for name in names:
                audit.record(tx, Source(f"u{number}"), "login", name)

    def write_again(number):
        for _ in range(50):
            with suppress(StoreUnavailableError):
                write(number)
                return
        raise AssertionError("never written")

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(write_again, range(80)))
    found = reports(database)
    assert {chain: (report.lines, report.fault) for chain, report in found.items()} == {
        "a": (80, None),
        "b": (80, None),
    }


@pytest.mark.parametrize(
    "change",
    [
        "UPDATE audit_events SET actor = 'ben' WHERE position = 2",
        "UPDATE audit_events SET robot = NULL WHERE position = 2",
        "DELETE FROM audit_events WHERE position = 3",
        "DELETE FROM audit_chains",
    ],
)
def test_change_past_the_accounts_is_found(database, admin_database, change):
    for number in range(3):
        record(database, number=number)
    assert reports(database)["sim1"].fault is None
    with admin_database.transaction() as tx:
        tx.change(change)
    assert [report.fault for report in reports(database).values() if report.fault]


def test_retention_deletes_up_to_a_signed_head_that_proves_the_rest(database, admin_database):
    for number in range(6):
        record(database, number=number)
    with admin_database.transaction() as tx:
        for position in (2, 4, 5):
            sign(tx, "sim1", position)
        tx.change(
            "UPDATE audit_heads SET signed_at = signed_at - INTERVAL 2 YEAR WHERE position < 5"
        )
    for _ in range(2):
        with admin_database.transaction() as tx:
            tx.change("CALL prune_history()")
        report = reports(database)["sim1"]
        assert (report.fault, report.deleted, report.lines) == (None, 4, 2)
    with admin_database.transaction() as tx:
        tx.change("DELETE FROM audit_heads WHERE position = 4")
    assert reports(database)["sim1"].fault is not None


def test_old_lines_stay_until_their_head_is_signed(database, admin_database):
    record(database)
    with admin_database.transaction() as tx:
        migrations.set_audit_days(tx, 1)
        tx.change("UPDATE audit_events SET at = at - INTERVAL 2 DAY")
        tx.change("CALL prune_history()")
        assert tx.row("SELECT COUNT(*) AS rows_ FROM audit_events") == {"rows_": 1}
