"""Who held control of a robot at a time."""

import datetime as dt
from urllib.parse import quote

import msgspec
import pytest
from api_visitor import new_public_key
from robotether_server import audit_chain
from robotether_server.audit_chain import ChainLine
from robotether_server.db import control, fleet
from robotether_server.db.control import DriveEntry
from robotether_server.db.fleet import AuditEntry, FormerSessions

NOW = dt.datetime.now(dt.UTC).replace(microsecond=0)
ROBOT = "sim1"


def minutes(count):
    """The time as long before the tests."""
    return NOW - dt.timedelta(minutes=count)


def line(kind, at, actor="ann", robot=ROBOT, **details):
    return AuditEntry(at, actor, kind, robot, "192.0.2.1", details)


@pytest.fixture
def write(relay_database):
    def write_entries(*entries):
        with relay_database.transaction() as tx:
            fleet.write(tx, entries, "main")

    return write_entries


@pytest.fixture
def at(root):
    """Ask as admin."""

    def ask(time, robot=ROBOT):
        return root.get(f"/robots/{robot}/controller?at={quote(time.isoformat())}")

    return ask


@pytest.fixture
def first_line(write, admin_database, root):
    """Write a line; those that the other fixtures wrote are an hour old."""
    with admin_database.transaction() as tx:
        tx.change("UPDATE audit_events SET at = at - INTERVAL 60 MINUTE")
        tx.change("UPDATE robots SET created_at = created_at - INTERVAL 60 MINUTE")
    write(line("robot_added", minutes(50), "root"))


def answer(reply):
    return reply["answer"], reply["user"], reply["reason"]


def test_driver_holds_control_from_start_to_end(at, write, first_line):
    """The start is within the drive, the end is not."""
    write(line("drive_started", minutes(30), fence=1), line("login", minutes(29)))
    write(line("drive_ended", minutes(20), fence=1, lasted_s=600.0))
    write(line("drive_started", minutes(20), "ben", fence=2))
    write(line("drive_ended", minutes(10), "ben", fence=2, lasted_s=600.0))
    instant = dt.timedelta(microseconds=1)
    for time, expected in (
        (minutes(30) - instant, ("nobody", None, None)),
        (minutes(30), ("driver", "ann", None)),
        (minutes(20) - instant, ("driver", "ann", None)),
        (minutes(20), ("driver", "ben", None)),
        (minutes(10), ("nobody", None, None)),
        (minutes(70), ("unknown", None, "before_log")),
        (NOW + dt.timedelta(days=1), ("unknown", None, "future")),
    ):
        assert answer(at(time)) == expected, time
    assert answer(at(dt.datetime.now(dt.UTC))) == ("unknown", None, "too_new")


def test_proof_has_the_lines_of_control_and_the_hashes_of_others(at, write, first_line):
    """They lead from the hash before them to the last; who is not an admin reads no other line there."""
    write(line("drive_started", minutes(30), fence=1))
    write(line("login", minutes(29)))
    write(line("drive_ended", minutes(20), fence=1, lasted_s=600.0))
    proof = at(minutes(25))["proof"]
    line_hash = proof["before"]
    for item in proof["lines"]:
        content = bytes.fromhex(item["content_hash"])
        if item["line"] is not None:
            shown = {name: value for name, value in item["line"].items() if name != "type"}
            assert audit_chain.content_hash(msgspec.convert(shown, ChainLine)) == content
        line_hash = audit_chain.next_hash(line_hash, content)
        assert item["hash"] == line_hash
    assert [item["line"] and item["line"]["kind"] for item in proof["lines"]] == [
        "drive_started",
        None,
        "drive_ended",
    ]
    assert (proof["server_head"], proof["robot_head"]) == (None, None)


def test_end_that_nobody_recorded_is_unknown(at, write, first_line, admin_database):
    """A relay that was killed says at its next start until when the drive lasted at least."""
    with admin_database.transaction() as tx:
        row = tx.row("SELECT id FROM robots WHERE name = %s", (ROBOT,))
        lease = control.NewLease(row["id"], None, "ann", minutes(30))
        assert control.next_fence(tx, lease, "main") == 1
    write(DriveEntry(row["id"], ROBOT, "ann", 1, minutes(30)))
    write(line("drive_started", minutes(30), fence=1))
    with admin_database.transaction() as tx:
        tx.change("UPDATE drives SET updated_at = %s", (minutes(20),))
    for ended in (False, True):
        if ended:
            write(FormerSessions(NOW))
        assert answer(at(minutes(20))) == ("driver", "ann", None)
        assert answer(at(minutes(15))) == ("unknown", None, "end_unknown")
    assert at(minutes(15))["at_least_until"].startswith(minutes(20).isoformat()[:19])


LOST = {"since": minutes(30).isoformat(), "until": minutes(25).isoformat(), "count": 3}
EARLIER = [
    line("drive_started", minutes(40), fence=1),
    line("drive_ended", minutes(35), fence=1, lasted_s=300.0),
]


@pytest.mark.parametrize(
    ("lines", "answers"),
    [
        pytest.param(
            [line("drive_ended", minutes(20), fence=1, lasted_s=600.0)],
            {25: ("driver", "ann", None), 35: ("nobody", None, None)},
            id="log begins in a drive",
        ),
        pytest.param(
            # As record_restore() writes it.
            [*EARLIER, line("records_restored", minutes(20), records_of=minutes(30).isoformat())],
            {
                37: ("driver", "ann", None),
                31: ("nobody", None, None),
                30: ("unknown", None, "restored"),
                20: ("nobody", None, None),
            },
            id="backup put back",
        ),
        pytest.param(
            [
                *EARLIER,
                line("lines_lost", minutes(20), "relay", **LOST),
                line("drive_ended", minutes(15), "ben", fence=2),
                line("drive_started", minutes(10), fence=3),
                line("drive_ended", minutes(5), fence=3),
            ],
            {
                31: ("nobody", None, None),
                30: ("unknown", None, "lines_lost"),
                16: ("unknown", None, "lines_lost"),
                15: ("nobody", None, None),
                10: ("driver", "ann", None),
            },
            id="relay could not write",
        ),
    ],
)
def test_what_no_line_tells_is_unknown(at, write, first_line, lines, answers):
    write(*lines)
    assert {ago: answer(at(minutes(ago))) for ago in answers} == answers


def test_robot_that_was_renamed_is_followed(at, write, first_line, root):
    write(line("drive_started", minutes(30), fence=1))
    write(line("drive_ended", minutes(20), fence=1, lasted_s=600.0))
    root.ask("PATCH", f"/robots/{ROBOT}", {"name": "new"})
    assert answer(at(minutes(25), "new")) == ("driver", "ann", None)
    assert at(minutes(25), "new")["robot"] == ROBOT
    # There and back, while another robot had the name.
    for name, new in (("sim2", ROBOT), (ROBOT, "sim2"), ("new", ROBOT)):
        root.ask("PATCH", f"/robots/{name}", {"name": new})
    assert answer(at(minutes(25))) == ("driver", "ann", None)
    assert answer(at(minutes(25), "sim2")) == ("unknown", None, "before_log")


def test_robot_with_the_name_of_a_removed_one_has_none_of_its_drives(at, write, first_line, root):
    """The former robot's drive has no end, and the same number as a drive of this one."""
    write(line("drive_started", minutes(30), fence=1))
    root.ask("DELETE", f"/robots/{ROBOT}")
    body = {"mac": "00:1b:44:00:00:09", "public_key": new_public_key()}
    assert root.ask("PUT", f"/robots/{ROBOT}", body).status_code == 201
    added = dt.datetime.now(dt.UTC)
    write(line("drive_started", added, "ben", fence=1))
    write(line("drive_ended", added, "ben", fence=1, lasted_s=0.0))
    assert answer(at(minutes(25))) == ("unknown", None, "before_log")
    assert at(added - dt.timedelta(microseconds=1))["user"] is None
