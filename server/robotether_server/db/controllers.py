"""Who held control of a robot at a time, by the lines of the audit log, and the part of the chain that proves it."""

import datetime as dt
import json
from dataclasses import dataclass, replace
from typing import Literal

from robotether_server.audit_chain import LINES_LOST, RESTORED, ChainLine, SignedHead, content_hash
from robotether_server.db import audit_chains, cells
from robotether_server.db.database import Row, Transaction
from robotether_server.schemas import Count, Timestamp

Answer = Literal["driver", "nobody", "unknown"]
# Why the answer is unknown.
Reason = Literal["future", "too_new", "before_log", "end_unknown", "restored", "lines_lost"]
# Time for which lines may still be on their way from a relay.
WRITTEN_WITHIN_S = 10
# Maximum number of lines of a proof.
MAX_LINES = 500
# Lines that say who has control; of all others a proof has the hash alone.
STARTS, ENDS = ("drive_started", "calls_started"), ("drive_ended", "calls_ended")
CONTROL = (*STARTS, *ENDS)


@dataclass(frozen=True)
class ProofLine:
    """A line of the chain: its content's SHA-256, the chain's hash, and the line itself if it says who has control."""

    position: Count
    content_hash: str
    hash: str
    line: ChainLine | None


@dataclass(frozen=True)
class Proof:
    """Lines of a chain in order, the hash of the line before the first, and the next signed heads.

    A head is None if there is none, or too many lines are before it: then it is in `robotether audit export`.
    """

    chain: str
    before: str
    lines: list[ProofLine]
    server_head: SignedHead | None
    robot_head: SignedHead | None


@dataclass(frozen=True)
class Controller:
    """Who held control at a time; `since` and `until` are the times of the lines, None: there is none.

    `at_least_until`: of a drive whose end was not recorded, until when it lasted at least.
    """

    robot: str
    at: Timestamp
    answer: Answer
    reason: Reason | None = None
    user: str | None = None
    fence: Count | None = None
    since: Timestamp | None = None
    until: Timestamp | None = None
    at_least_until: Timestamp | None = None
    proof: Proof | None = None


def find(tx: Transaction, robot: str, at: dt.datetime) -> Controller:
    """Return who held control of a robot; one that was renamed since has the name of that time."""
    now = tx.now()
    if at > now:
        return Controller(robot, at, "unknown", "future")
    chain, since = _name_at(tx, robot, at)
    # Of what another robot of that name left before, nothing counts.
    first = _line(tx, chain, "at >= %s", (since,), "position")
    if first is None or at < first["at"]:
        return Controller(chain, at, "unknown", "before_log")
    if _may_be_lost(tx, chain, at):
        return Controller(chain, at, "unknown", "restored")
    if _were_lost(tx, chain, at):
        return Controller(chain, at, "unknown", "lines_lost")
    controller = _find(tx, chain, at, first)
    if controller.answer != "driver" and at > now - dt.timedelta(seconds=WRITTEN_WITHIN_S):
        return Controller(chain, at, "unknown", "too_new", proof=controller.proof)
    return controller


def _may_be_lost(tx: Transaction, chain: str, at: dt.datetime) -> bool:
    """Whether a backup was put back later that need not have all lines of that time."""
    written_by = at + dt.timedelta(seconds=WRITTEN_WITHIN_S)
    rows = tx.rows(
        "SELECT JSON_VALUE(details, '$.records_of') AS records_of FROM audit_events "
        "WHERE robot = %s AND position IS NOT NULL AND kind = %s AND at > %s",
        (chain, RESTORED, at),
    )
    times = [row["records_of"] for row in rows]
    return any(time is None or written_by > dt.datetime.fromisoformat(time) for time in times)


def _were_lost(tx: Transaction, chain: str, at: dt.datetime) -> bool:
    """Whether a relay could not write lines of that time, or of before, and no line of control has followed them."""
    rows = tx.rows(
        "SELECT details FROM audit_events WHERE robot = %s AND position IS NOT NULL AND kind = %s",
        (chain, LINES_LOST),
    )
    for details in map(_details, rows):
        since = dt.datetime.fromisoformat(str(details["since"]))
        until = dt.datetime.fromisoformat(str(details["until"]))
        condition = "kind IN %s AND at > %s AND at <= %s"
        if at >= since and _line(tx, chain, condition, (CONTROL, until, at), "at") is None:
            return True
    return False


def _find(tx: Transaction, chain: str, at: dt.datetime, first: Row) -> Controller:
    condition = "kind IN %s AND at <= %s AND position >= %s"
    values = (STARTS, at, first["position"])
    start = _line(tx, chain, condition, values, "at DESC, position DESC")
    if start is None:
        return _before_first_start(tx, chain, at, first)
    fence = _details(start).get("fence")
    end = _line(
        tx,
        chain,
        "kind IN %s AND position > %s AND JSON_VALUE(details, '$.fence') = %s",
        (ENDS, start["position"], fence),
        "position",
    )
    last = start["position"] if end is None else end["position"]
    drive = Controller(
        chain,
        at,
        "driver",
        user=start["actor"],
        fence=fence,  # type: ignore[arg-type] # the relay writes a number
        since=start["at"],
        proof=_proof(tx, chain, start["position"], last),
    )
    if end is None:
        return _without_end(tx, drive)
    if end["at"] <= at:
        return Controller(chain, at, "nobody", since=end["at"], proof=drive.proof)
    lasted = _details(end).get("at_least_until")
    if lasted is None:
        return replace(drive, until=end["at"])
    return _at_least(drive, dt.datetime.fromisoformat(str(lasted)))


def _at_least(
    drive: Controller, until: dt.datetime | None, reason: Reason = "end_unknown"
) -> Controller:
    """The driver until that time; later it is unknown."""
    drive = replace(drive, at_least_until=until)
    if until is not None and drive.at <= until:
        return drive
    return replace(drive, answer="unknown", reason=reason, user=None, fence=None)


def _before_first_start(tx: Transaction, chain: str, at: dt.datetime, first: Row) -> Controller:
    """Nobody, unless the chain begins within a drive: then its first line of control is an end."""
    condition = "kind IN %s AND position >= %s"
    control = _line(tx, chain, condition, (CONTROL, first["position"]), "position")
    if control is None or control["kind"] in STARTS:
        proof = _proof(tx, chain, first["position"], first["position"])
        return Controller(chain, at, "nobody", proof=proof)
    proof = _proof(tx, chain, first["position"], control["position"])
    if control["at"] <= at:
        return Controller(chain, at, "nobody", since=control["at"], proof=proof)
    details = _details(control)
    lasted_s = details.get("lasted_s")
    if not isinstance(lasted_s, int | float):
        return Controller(chain, at, "unknown", "end_unknown", proof=proof)
    if at < control["at"] - dt.timedelta(seconds=lasted_s):
        return Controller(chain, at, "nobody", proof=proof)
    fence = details.get("fence")
    return Controller(
        chain,
        at,
        "driver",
        user=control["actor"],
        fence=fence,  # type: ignore[arg-type] # as above
        until=control["at"],
        proof=proof,
    )


def _without_end(tx: Transaction, drive: Controller) -> Controller:
    """A drive lasted at least until its relay last wrote of it; nobody knows whether it did later."""
    row = tx.row(
        f"SELECT s.updated_at, s.ended_at IS NULL AND NOT {cells.IS_LOST} AS lasts FROM drives s "  # noqa: S608 - texts of the modules
        # The newest: another robot of that name may have had a drive of that number.
        "WHERE s.robot = %s AND s.fence = %s AND s.started_at <= %s ORDER BY s.id DESC LIMIT 1",
        (drive.robot, drive.fence, drive.at),
    )
    if row is None:
        return _at_least(drive, None)
    return _at_least(drive, row["updated_at"], "too_new" if row["lasts"] else "end_unknown")


def _name_at(tx: Transaction, robot: str, at: dt.datetime) -> tuple[str, dt.datetime]:
    """Return the name that the robot had then, and since when; each may have been another robot's before."""
    [row] = tx.rows("SELECT created_at FROM robots WHERE name = %s", (robot,))
    name, until = robot, tx.now()
    while True:
        # Back from now, by the names that this robot had.
        condition = "kind = 'robot_renamed' AND at BETWEEN %s AND %s"
        values = (row["created_at"], until)
        renamed = _line(tx, name, condition, values, "at DESC, position DESC")
        if renamed is None or renamed["at"] <= at:
            return name, renamed["at"] if renamed else row["created_at"]
        name = str(_details(renamed)["was"])
        until = renamed["at"] - dt.timedelta(microseconds=1)


def _proof(tx: Transaction, chain: str, first: int, last: int) -> Proof:
    """Return the lines from `first` to the next signed heads from `last` on."""
    server = audit_chains.next_head(tx, chain, "server", last)
    robot = audit_chains.next_head(tx, chain, "robot", last)
    until = max([last, *(head.position for head in (server, robot) if head)])
    count = min(until - first + 1, MAX_LINES)
    lines = audit_chains.read_lines(tx, chain, first - 1, count)
    newest = lines[-1].position if lines else 0
    return Proof(
        chain,
        audit_chains.hash_before(tx, chain, first),
        [
            ProofLine(
                line.position,
                content_hash(line).hex(),
                line.hash,
                line if line.kind in CONTROL else None,
            )
            for line in lines
        ],
        server if server and server.position <= newest else None,
        robot if robot and robot.position <= newest else None,
    )


def _line(
    tx: Transaction, chain: str, condition: str, values: tuple[object, ...], sorting: str
) -> Row | None:
    return tx.row(
        "SELECT position, at, actor, kind, details FROM audit_events WHERE robot = %s "  # noqa: S608 - the module's own texts
        f"AND position IS NOT NULL AND {condition} ORDER BY {sorting} LIMIT 1",
        (chain, *values),
    )


def _details(row: Row) -> dict[str, object]:
    details: dict[str, object] = json.loads(row["details"])
    return details
