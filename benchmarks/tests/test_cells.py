"""The checker of cells: each rule is broken once, and what is allowed is no violation."""

from __future__ import annotations

from typing import Any

import pytest
from paper.cells.checker import Database, check, find_ignored_stops, find_returns
from paper.cells.history import Event, in_order

CELLS = ("main", "second")
WHOLE = Database(drives={("one", 1), ("one", 2)}, fences={"one": 2})


def event(at_s: float, kind: Any, **more: Any) -> Event:
    usual = {"robot": "one", "source": "robots"} if kind not in ("fault", "healed", "late") else {}
    return Event(at_s=at_s, kind=kind, **{**usual, **more})


def driven(
    connection: str, fence: int, begin_s: float, end_s: float, first: int = 0
) -> list[Event]:
    """Commands at 20 Hz that come and move the robot, and a zero behind the last."""
    events = []
    for at in range(round((end_s - begin_s) * 20)):
        at_s, command = begin_s + at / 20, {"connection": connection, "number": first + at}
        events += [
            event(at_s, "arrived", fence=fence, **command),
            event(at_s + 0.001, "moved", **command),
        ]
    return [*events, event(end_s + 0.4, "zeroed")]


ANN = driven("ann", 1, 1, 2)
MOVING = ANN[:-1]
STOP = [event(1.2, "stop_asked"), event(1.3, "stop_done")]
CONFIRMED = [STOP[0], event(1.3, "stop_done", number=1)]
WRITTEN = [STOP[0], event(1.3, "stop_done", what="nemesis 7", cell="main")]
RELEASE = [event(2, "release_asked"), event(2.1, "release_done")]
LATE_RELEASE = [event(1, "release_asked"), event(2, "stop_asked"), event(2.1, "stop_done")]
GUARDS = [event(2, "guard_killed"), event(2.3, "guard_began")]
SITE = [event(1, "recorded", robot="", what="site 7", cell="main")]
# A relay is killed while the database is away.
AWAY = [event(0, "fault", what="database_away"), event(20, "healed", what="database_away")]
AWAY += [event(1.4, "fault", what="relay_killed", cell="main")]
STOPPED = Database(drives={("one", 1)}, fences={"one": 1}, stopped={"one"})


def late(source: str) -> Event:
    return event(2.6, "late", source=source, number=300)


def sessions(*epochs: int) -> list[Event]:
    return [event(at, "session", cell="main", epoch=epoch) for at, epoch in enumerate(epochs)]


# What happened, what the database has, and the rules that are broken.
HISTORIES = {
    "drives, one after the other": ([*sessions(10, 11), *ANN, *driven("ben", 2, 5, 6)], WHOLE, ""),
    "a command that never came to the guard":
        ([event(1, "moved", connection="ann", number=7), event(1.1, "zeroed")], WHOLE, "unknown command"),
    "two drivers at once": ([*ANN, *driven("ben", 2, 1.5, 2.5)], WHOLE, "old fence, two drivers"),
    "a driver who comes back by the same connection":
        ([*ANN, *driven("ben", 2, 2, 3), *driven("ann", 3, 3, 3.05, 99)],
         Database(drives={("one", 1), ("one", 2), ("one", 3)}, fences={"one": 3}), "two drivers"),
    "an old fence": ([*driven("ann", 2, 1, 2), *driven("ben", 1, 3, 3.05)], WHOLE, "old fence"),
    "a number for two": ([*ANN, *driven("ben", 1, 3, 4)], WHOLE, "shared fence"),
    "a number for two, one of whom moves nothing":
        ([*ANN, event(3, "arrived", connection="ben", fence=1)], WHOLE, "shared fence"),
    "a move after the guard's word": ([*driven("ann", 1, 1, 1.7), event(1.5, "stopped")], WHOLE, "stop undone"),
    "a move that was under way": ([*driven("ann", 1, 1, 1.55), event(1.5, "stopped")], WHOLE, ""),
    "a move after the server's word": ([*driven("ann", 1, 1, 1.7), *CONFIRMED], STOPPED, "stop undone"),
    "a move after a stop that was only sent": ([*driven("ann", 1, 1, 1.7), *STOP], STOPPED, ""),
    "moves after a release":
        ([*driven("ann", 1, 0, 1), *CONFIRMED, event(1.3, "stopped"), *RELEASE, event(2.1, "released"),
          *driven("ann", 2, 3, 4, 99)], WHOLE, ""),
    "a release of nobody": ([event(1, "stopped"), event(2, "released")], WHOLE, "release of nobody"),
    "a late release that undoes a newer stop": ([*LATE_RELEASE, event(3, "released")], STOPPED, "release of nobody"),
    "a release that was asked for again":
        ([*LATE_RELEASE, event(2.5, "release_asked"), event(3, "released")], STOPPED, ""),
    "motion without a driver": ([*MOVING, event(2.7, "zeroed")], WHOLE, "moves without a driver"),
    "motion that ends in time": ([*MOVING, event(2.5, "zeroed")], WHOLE, ""),
    "motion without an end":
        ([*MOVING, event(9, "late", source="others", number=1)], WHOLE, "moves without a driver"),
    "a zero of a process that was held up": ([*MOVING, late("robots"), event(2.7, "zeroed")], WHOLE, ""),
    "a zero while another process was held up":
        ([*MOVING, late("others"), event(2.7, "zeroed")], WHOLE, "moves without a driver"),
    "a zero of the next guard": ([*MOVING, *GUARDS, event(3.3, "zeroed")], WHOLE, ""),
    "a late zero of the next guard": ([*MOVING, *GUARDS, event(3.9, "zeroed")], WHOLE, "moves without a driver"),
    "an epoch that is not newer": (sessions(5, 5), WHOLE, "old epoch"),
    "a drive that is not written": (ANN, Database(drives={("one", 2)}, fences={"one": 2}), "lost record"),
    "a fence that is not written":
        (driven("ann", 2, 1, 2), Database(drives={("one", 2)}, fences={"one": 1}), "lost record"),
    "a site that is not written": (SITE, Database(), "lost record"),
    "a site that is written": (SITE, Database(recorded={"site 7"}), ""),
    "a stop that is not written": (WRITTEN, STOPPED, "lost record"),
    "a stop that is written": (WRITTEN, Database(stopped={"one"}, stop_reasons={"nemesis 7"}), ""),
    "a stop that a killed relay had": ([*WRITTEN, *AWAY], STOPPED, "lost record"),
    "a stop that the database does not have": (STOP, Database(), "stop undone"),
    "a release": ([*STOP, *RELEASE], Database(), ""),
    "a release that the database does not have": ([*STOP, *RELEASE], STOPPED, "release undone"),
    "a release without an answer, of which nobody knows": ([*STOP, RELEASE[0]], STOPPED, ""),
    "two open sessions": (sessions(1), Database(open_sessions={"one": 2, "two": 1}), "several sessions"),
}  # fmt: skip


@pytest.mark.parametrize(("history", "database", "rules"), HISTORIES.values(), ids=HISTORIES)
def test_a_history_breaks_these_rules(history: list[Event], database: Database, rules: str) -> None:
    broken = {violation.rule for violation in check(in_order(history), database)}
    assert ", ".join(sorted(broken)) == rules


def test_a_route_has_one_lease_for_the_commands_of_several_connections():
    history = in_order([*driven("ann", 1, 1, 2), *driven("ben", 1, 3, 4)])
    assert check(history, WHOLE, follower="one") == []


def test_a_stop_that_the_robot_did_not_get_for_a_while():
    found = find_ignored_stops(in_order([*driven("ann", 1, 1, 3), *STOP, event(4, "stopped")]))
    assert found == [pytest.approx(1.65, abs=0.01)]
    assert find_ignored_stops(in_order([*driven("ann", 1, 1, 1.35), *STOP])) == []


# How soon a robot is drivable again.

WANTS = event(0, "wants", what="ann")
LEAVES = event(100, "leaves", what="ann")
KILLED = event(2, "fault", what="cell_killed", cell="main")
HEALED = event(50, "healed", what="cell_killed", cell="main")
DRAINED = event(2, "fault", what="cell_drained", cell="main")
FIRST = [WANTS, *driven("a1", 1, 0, 2)]


def left(at_s: float) -> Event:
    return event(at_s, "leaves", what="ann")


def fault(at_s: float, what: str, cell: str = "second", **more: str) -> Event:
    return event(at_s, "fault", what=what, cell=cell, **more)


AT_MAIN, AT_SECOND = (event(0, "session", cell=cell, epoch=1) for cell in CELLS)
FROM_1 = [event(1, "wants", what="ann"), DRAINED, *driven("a1", 1, 5, 6), left(6)]
# What happened, and the returns: from when, how long it took, and whether the robot was driven at the end.
RETURNS = {
    "to another cell": ([*FIRST, KILLED, *driven("a2", 2, 5, 6), HEALED, left(6.1)], [(2, 3.0, True)]),
    "when a cell is live again":
        ([*FIRST, KILLED, fault(3, "cell_paused"), event(9, "healed", what="cell_paused", cell="second"),
          *driven("a2", 2, 10, 11), HEALED, left(11.1)], [(9, 1.0, True)]),
    "of a robot that is cut from one cell":
        ([*FIRST, fault(2, "robots_cut", "main", source="robots"), fault(3, "robots_cut", source="others"),
          *driven("a2", 2, 4, 5)], [(2, 2.0, True)]),
    "from a drain on, for a robot at that cell": ([AT_MAIN, *FROM_1], [(2, 3.0, True)]),
    "from before a drain of another cell": ([AT_SECOND, *FROM_1], [(1, 4.0, True)]),
    "to a drained cell that alone is left":
        ([AT_MAIN, *FIRST, DRAINED, fault(3, "cell_paused"), *driven("a2", 2, 9, 10), left(10)], [(3, 6.0, True)]),
    "none without a live cell": ([*FIRST, KILLED, fault(2, "sshd_killed"), LEAVES], []),
    "without a database":
        ([*FIRST, event(2, "fault", what="database_away"), *driven("a2", 2, 5, 6), left(6.1)], [(1.95, 3.05, True)]),
    "of a robot whose driver gives up": ([*FIRST, KILLED, LEAVES], [(2, 98.0, False)]),
    "none while nobody wants":
        ([*FIRST, left(2), KILLED, event(50, "wants", what="ben"), *driven("b1", 2, 50.2, 51)], []),
    "from the release of a stopped robot":
        ([*FIRST, event(2, "stop_asked"), event(60, "release_done"), *driven("a2", 2, 62, 63)], [(60, 2.0, True)]),
}  # fmt: skip


@pytest.mark.parametrize(("history", "expected"), RETURNS.values(), ids=RETURNS)
def test_returns(history: list[Event], expected: list[tuple[float, float, bool]]) -> None:
    found = find_returns(in_order(history), CELLS)
    assert [(round(item.at_s, 2), round(item.took_s, 2), item.came) for item in found] == expected


def test_a_fault_that_takes_a_moment_is_still_the_cause():
    history = [WANTS, *driven("a1", 1, 0, 2.2), KILLED, *driven("a2", 2, 5, 6), HEALED, left(6.1)]
    [found] = find_returns(in_order(history), CELLS)
    assert (round(found.took_s, 2), found.after) == (2.85, "cell_killed")
