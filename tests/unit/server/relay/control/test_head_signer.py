"""Heads of the audit log's chains, signed by relay and robot, in the real database."""

import asyncio
import datetime as dt
import hashlib
import json
from types import SimpleNamespace

import pytest
from relay_server import until
from robot_signer import RobotSigner
from robotether_common.audit_head import NAMESPACE, statement
from robotether_server import audit_chain
from robotether_server.audit_chain import server_key
from robotether_server.db import Database, audit_chains, fleet
from robotether_server.db.fleet import AuditEntry, RelayRobot, Snapshot
from robotether_server.problems import StoreUnavailableError
from robotether_server.relay.control import head_signer
from robotether_server.relay.control.head_signer import HeadSigner
from robotether_server.relay.records.database import RelayDatabase
from robotether_server.relay.robots.session_messages import SignedHeadLine

NOON = dt.datetime(2026, 1, 1, 12, 0, tzinfo=dt.UTC)
ROBOT = RobotSigner(1)
DRIVE_END = AuditEntry(NOON, "ann", "drive_ended", "sim1", None, {"fence": 1})


class Robot:
    """A robot's session: what the relay sends it."""

    def __init__(self):
        self.asked = []
        self.expected_heads = 0

    def session_of(self, _robot_id):
        return self

    robot = ensure_robot = session_of

    def send(self, line):
        self.asked.append(json.loads(line))


def signed(request, signer=ROBOT, previous=None, **changes):
    """The robot's answer to a request."""
    position, line_hash = request["position"], changes.get("hash", request["hash"])
    text = statement(request["chain"], position, line_hash, previous)
    return SignedHeadLine(position, line_hash, signer.sign(NAMESPACE, text), previous)


def statement_hash(statements):
    """What the robot's next statement names."""
    if not statements:
        return None
    last = statements[-1]
    text = statement("sim1", last.position, last.hash, last.previous)
    return hashlib.sha256(text.encode()).hexdigest()


@pytest.fixture
def quick_sweeps(monkeypatch):
    monkeypatch.setattr(head_signer, "SWEEP_EVERY_S", 0.2)


@pytest.fixture
async def parts(mariadb, relay_database):
    """The signer at work, the robot, and what writes the end of a drive."""
    robot = Robot()
    row = RelayRobot(1, "sim1", "active", 20000, 20001, fingerprint=ROBOT.key.fingerprint)
    database = RelayDatabase(Database(mariadb.settings("relay")), "main", answer_within_s=30)
    signer = HeadSigner(database, robot, lambda: Snapshot({1: row}, {}), server_key("x" * 32))

    def end_drive():
        with relay_database.transaction() as tx:
            fleet.write(tx, [DRIVE_END])
        signer.on_written([DRIVE_END])

    task = asyncio.create_task(signer.run())
    yield SimpleNamespace(signer=signer, robot=robot, end_drive=end_drive)
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    database.close()


def report(database):
    with database.transaction() as tx:
        (only,) = audit_chain.check(audit_chains.read_chains(tx))
    return only


async def test_server_and_robot_sign_at_each_drives_end(parts, database):
    """A robot that does not answer is shown as not having signed."""
    parts.end_drive()
    await until(lambda: parts.robot.asked, "what is asked and signed")
    assert (report(database).fault, report(database).signed) == (None, {"server": 1})
    first = parts.robot.asked[0]
    assert (first["type"], first["chain"], first["newest"]) == ("sign_head", "sim1", None)
    parts.signer.on_signed_head(1, signed(first))
    await until(lambda: report(database).signed == {"server": 1, "robot": 1}, "all is signed")
    parts.end_drive()
    await until(lambda: len(parts.robot.asked) == 2, "what is asked and signed")
    known = parts.robot.asked[1]["newest"]
    parts.signer.on_signed_head(1, signed(parts.robot.asked[1], previous=known))
    await until(lambda: report(database).signed == {"server": 2, "robot": 2}, "all is signed")
    assert report(database).fault is None


async def test_what_a_robot_signed_is_kept_from_the_first_on(parts, database, monkeypatch):
    """What the database does not take waits, as the second of two names the first; what finds no room is lost."""
    answers = []
    for number in (1, 2):
        parts.end_drive()
        await until(lambda count=number: len(parts.robot.asked) == count, "what the relay asks")
        answers.append(signed(parts.robot.asked[-1], previous=statement_hash(answers)))
    refused = []

    def refuse(_tx, head):
        refused.append(head)
        raise StoreUnavailableError("it is away")

    monkeypatch.setattr(head_signer, "MAX_ANSWERS", 1)
    with monkeypatch.context() as patch:
        patch.setattr(audit_chains, "add_robots_head", refuse)
        for answer in answers:
            parts.signer.on_signed_head(1, answer)
        await until(lambda: refused, "what the relay stores in vain")
    parts.end_drive()
    await until(lambda: report(database).signed["server"] == 3, "what is signed")
    assert (report(database).fault, report(database).signed["robot"]) == (None, 1)


async def test_lines_without_a_drive_are_signed_too(quick_sweeps, parts, database, admin_database):
    """Once a day, as are lines without a robot."""
    with admin_database.transaction() as tx:
        fleet.write(tx, [AuditEntry(NOON, "ann", "login")])
    await until(lambda: report(database).signed == {"server": 1}, "what is asked and signed")


async def test_what_a_robot_signed_before_a_restore_stays_visible(parts, database, admin_database):
    """It signs lines 1 and 2; a backup from between them is put back; then it signs 4, which names 2.

    Retention deletes what it signed of line 2 with the restore's line.
    """
    statements = []

    async def end_drive_signed(position):
        parts.end_drive()
        await until(lambda: len(parts.robot.asked) > len(statements), "what the relay asks")
        statements.append(signed(parts.robot.asked[-1], previous=statement_hash(statements)))
        for item in statements:
            parts.signer.on_signed_head(1, item)
        await until(lambda: report(database).signed.get("robot") == position, "what is stored")

    await end_drive_signed(1)
    await end_drive_signed(2)
    with admin_database.transaction() as tx:
        for table in ("audit_heads", "audit_events"):
            tx.change(f"DELETE FROM {table} WHERE position > 1")
        tx.change("UPDATE audit_chains SET position = 1, hash = UNHEX(%s)", (statements[0].hash,))
        tx.change("CALL record_restore()")
        fleet.write(tx, [DRIVE_END])
    await end_drive_signed(4)
    found = report(database)
    assert found.fault is None
    assert [(item.line, item.lost_up_to) for item in found.restores] == [(2, 2)]
    with admin_database.transaction() as tx:
        tx.change("CALL prune_audit_chains(CURRENT_TIMESTAMP(6) + INTERVAL 1 DAY)")
    assert (report(database).fault, report(database).restores) == (None, [])


@pytest.mark.parametrize("wrong", ["key", "hash", "signature", "unasked"])
async def test_wrong_answer_is_dropped(parts, database, caplog, wrong):
    parts.end_drive()
    await until(lambda: parts.robot.asked, "what is asked and signed")
    (request,) = parts.robot.asked
    answers = {
        "key": signed(request, RobotSigner(2)),
        "hash": signed(request, hash="0" * 64),
        "signature": SignedHeadLine(1, request["hash"], "x"),
        "unasked": signed(request),
    }
    parts.signer.on_signed_head(2 if wrong == "unasked" else 1, answers[wrong])
    # What comes behind shows that it was handled.
    parts.end_drive()
    await until(lambda: len(parts.robot.asked) == 2, "what is asked and signed")
    assert (report(database).fault, report(database).signed) == (None, {"server": 2})
