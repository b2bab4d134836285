"""The history of cells and its checker: each rule is broken once, and what is allowed is no violation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from paper.cells.checker import (
    Database,
    Return,
    check,
    find_crowds,
    find_ignored_stops,
    find_returns,
)
from paper.cells.history import Event, History, in_order, read

CELLS = ("main", "second")
WHOLE = Database(drives={("one", 1), ("one", 2)}, fences={"one": 2}, stopped=())


def event(at_s: float, kind: Any, **more: Any) -> Event:
    usual = {"robot": "one", "source": "robots"} if kind not in ("fault", "healed", "late") else {}
    return Event(at_s=at_s, kind=kind, **{**usual, **more})


def driven(
    connection: str, fence: int, begin_s: float, end_s: float, first: int = 0
) -> list[Event]:
    """Commands at 20 Hz that come and move the robot, and a zero behind the last."""
    events = []
    for at in range(round((end_s - begin_s) * 20)):
        at_s, one = begin_s + at / 20, {"connection": connection, "number": first + at}
        events += [event(at_s, "arrived", fence=fence, **one), event(at_s + 0.001, "moved", **one)]
    return [*events, event(end_s + 0.4, "zeroed")]


def broken(*events: Event, database: Database = WHOLE) -> list[str]:
    return [one.rule for one in check(in_order(events), database)]


def test_a_drive_after_another_breaks_nothing():
    history = [
        event(0, "session", cell="main", epoch=10),
        *driven("ann", 1, 1, 2),
        event(3, "session_lost", cell="main"),
        event(4, "session", cell="second", epoch=11),
        *driven("ben", 2, 5, 6),
    ]
    assert broken(*history) == []


def test_a_command_that_never_came_to_the_guard():
    assert broken(event(1, "moved", connection="ann", number=7), event(1.1, "zeroed")) == [
        "unknown command"
    ]


def test_two_drivers_at_once():
    history = [*driven("ann", 1, 1, 2), *driven("ben", 2, 1.5, 2.5)]
    assert set(broken(*history)) == {"two drivers", "old fence"}


def test_a_driver_who_comes_back_by_the_same_connection():
    history = [*driven("ann", 1, 1, 2), *driven("ben", 2, 2, 3), *driven("ann", 3, 3, 3.05, 99)]
    database = Database(drives={("one", 1), ("one", 2), ("one", 3)}, fences={"one": 3})
    assert broken(*history, database=database) == ["two drivers"]


def test_an_old_fence_after_a_newer_one():
    assert broken(*driven("ann", 2, 1, 2), *driven("ben", 1, 3, 3.05)) == ["old fence"]


def test_one_number_for_two_connections():
    assert broken(*driven("ann", 1, 1, 2), *driven("ben", 1, 3, 4)) == ["shared fence"]


def test_a_number_for_two_connections_also_when_the_guard_lets_one_move_nothing():
    second = event(3, "arrived", connection="ben", fence=1)
    assert broken(*driven("ann", 1, 1, 2), second) == ["shared fence"]


def test_a_move_after_the_guard_has_confirmed_a_stop():
    stop = event(1.5, "stopped")
    assert set(broken(*driven("ann", 1, 1, 1.7), stop)) == {"stop undone"}
    # What was under way then is none.
    assert broken(*driven("ann", 1, 1, 1.55), stop) == []


def test_a_move_after_the_server_has_confirmed_a_stop():
    asked = [event(1.2, "stop_asked"), event(1.3, "stop_done", number=1)]
    database = Database(drives={("one", 1)}, fences={"one": 1}, stopped={"one"})
    assert set(broken(*driven("ann", 1, 1, 1.7), *asked, database=database)) == {"stop undone"}
    # Without the guard's word it is only sent.
    asked[1] = event(1.3, "stop_done")
    assert broken(*driven("ann", 1, 1, 1.7), *asked, database=database) == []


def test_moves_after_a_release():
    stopped = [event(1.2, "stop_asked"), event(1.3, "stopped"), event(1.3, "stop_done", number=1)]
    released = [event(2, "release_asked"), event(2.1, "released"), event(2.1, "release_done")]
    history = [*driven("ann", 1, 0, 1), *stopped, *released, *driven("ann", 2, 3, 4, 99)]
    assert broken(*history) == []


def test_a_release_that_nobody_asked_for():
    assert broken(event(1, "stopped"), event(2, "released")) == ["release of nobody"]


def test_a_release_that_comes_late_and_undoes_a_newer_stop():
    history = [event(1, "release_asked"), event(2, "stop_asked"), event(2.1, "stop_done")]
    database = Database(stopped={"one"})
    assert broken(*history, event(3, "released"), database=database) == ["release of nobody"]
    asked_again = event(2.5, "release_asked")
    assert broken(*history, asked_again, event(3, "released"), database=database) == []


def test_motion_without_a_driver():
    last = driven("ann", 1, 1, 2)
    assert broken(*last[:-1], event(2.7, "zeroed")) == ["moves without a driver"]
    assert broken(*last[:-1], event(2.5, "zeroed")) == []


def test_motion_that_never_ends():
    *moving, _ = driven("ann", 1, 1, 2)
    assert broken(*moving, event(9, "late", source="others", number=1)) == [
        "moves without a driver"
    ]


def test_a_process_that_was_held_up_may_zero_later():
    *moving, _ = driven("ann", 1, 1, 2)
    late = event(2.6, "late", source="robots", number=300)
    assert broken(*moving, late, event(2.7, "zeroed")) == []
    other = event(2.6, "late", source="others", number=300)
    assert broken(*moving, other, event(2.7, "zeroed")) == ["moves without a driver"]


def test_a_guard_that_dies_in_motion_is_followed_by_one_that_zeroes():
    *moving, _ = driven("ann", 1, 1, 2)
    guards = [event(2, "guard_killed"), event(2.3, "guard_began")]
    assert broken(*moving, *guards, event(3.3, "zeroed")) == []
    assert broken(*moving, *guards, event(3.9, "zeroed")) == ["moves without a driver"]


def test_a_session_of_an_epoch_that_is_not_newer():
    history = [
        event(1, "session", cell="main", epoch=5),
        event(2, "session", cell="second", epoch=5),
    ]
    assert broken(*history) == ["old epoch"]


def test_a_drive_that_the_database_does_not_have():
    without = Database(drives={("one", 2)}, fences={"one": 2})
    assert broken(*driven("ann", 1, 1, 2), database=without) == ["lost record"]
    older = Database(drives={("one", 2)}, fences={"one": 1})
    assert broken(*driven("ann", 2, 1, 2), database=older) == ["lost record"]


def test_a_confirmed_record_that_the_database_does_not_have():
    history = [event(1, "recorded", robot="", what="site 7", cell="main")]
    assert broken(*history, database=Database()) == ["lost record"]
    assert broken(*history, database=Database(recorded={"site 7"})) == []


def test_a_stop_that_the_audit_log_does_not_have():
    stop = [event(1, "stop_asked"), event(1.1, "stop_done", what="nemesis 7", cell="main")]
    assert broken(*stop, database=Database(stopped={"one"})) == ["lost record"]
    written = Database(stopped={"one"}, stop_reasons={"nemesis 7"})
    assert broken(*stop, database=written) == []


def test_a_relay_that_is_killed_without_the_database_loses_nothing():
    stop = [event(1, "stop_asked"), event(1.1, "stop_done", what="nemesis 7", cell="main")]
    away = [event(0, "fault", what="database_away"), event(20, "healed", what="database_away")]
    killed = event(1.2, "fault", what="relay_killed", cell="main")
    database = Database(stopped={"one"})
    assert broken(*stop, *away, killed, database=database) == ["lost record"]


def test_a_stop_or_a_release_that_the_database_does_not_have():
    stop = [event(1, "stop_asked"), event(1.1, "stop_done")]
    assert broken(*stop, database=Database()) == ["stop undone"]
    release = [event(2, "release_asked"), event(2.1, "release_done")]
    assert broken(*stop, *release, database=Database()) == []
    assert broken(*stop, *release, database=Database(stopped={"one"})) == ["release undone"]
    # What became of a release without an answer nobody knows.
    assert broken(*stop, release[0], database=Database(stopped={"one"})) == []


def test_two_open_sessions_of_one_robot():
    database = Database(open_sessions={"one": 2, "two": 1})
    assert broken(event(1, "session", cell="main", epoch=1), database=database) == [
        "several sessions"
    ]


def test_a_stop_that_the_robot_did_not_get_for_a_while():
    asked = [event(1.2, "stop_asked"), event(1.3, "stop_done")]
    found = find_ignored_stops(in_order([*driven("ann", 1, 1, 3), *asked, event(4, "stopped")]))
    assert found == [pytest.approx(1.65, abs=0.01)]
    found = find_ignored_stops(in_order([*driven("ann", 1, 1, 1.35), *asked]))
    assert found == []


# How soon a robot is drivable again.


def returns(*events: Event) -> list[tuple[float, float, bool]]:
    found: list[Return] = find_returns(in_order(events), CELLS)
    return [(round(one.at_s, 2), round(one.took_s, 2), one.came) for one in found]


WANTS = event(0, "wants", what="ann")
LEAVES = event(100, "leaves", what="ann")
KILLED = event(2, "fault", what="cell_killed", cell="main")
HEALED = event(50, "healed", what="cell_killed", cell="main")


def test_a_robot_returns_to_another_cell():
    history = [WANTS, *driven("a1", 1, 0, 2), KILLED, *driven("a2", 2, 5, 6), HEALED]
    left = event(6.1, "leaves", what="ann")
    assert returns(*history, left) == [(2, 3.0, True)]
    [found] = find_returns(in_order([*history, left]), CELLS)
    assert found.after == "cell_killed"


def test_a_fault_that_takes_a_moment_is_still_the_cause():
    history = [WANTS, *driven("a1", 1, 0, 2.2), KILLED, *driven("a2", 2, 5, 6), HEALED]
    left = event(6.1, "leaves", what="ann")
    [found] = find_returns(in_order([*history, left]), CELLS)
    assert (round(found.took_s, 2), found.after) == (2.85, "cell_killed")


def test_the_clock_begins_when_a_cell_is_live_again():
    second = event(3, "fault", what="cell_paused", cell="second")
    back = event(9, "healed", what="cell_paused", cell="second")
    history = [WANTS, *driven("a1", 1, 0, 2), KILLED, second, back, *driven("a2", 2, 10, 11)]
    left = event(11.1, "leaves", what="ann")
    assert returns(*history, HEALED, left) == [(9, 1.0, True)]


def test_a_robot_that_is_cut_from_one_cell_has_another():
    cut = event(2, "fault", what="robots_cut", cell="main", source="robots")
    others = event(3, "fault", what="robots_cut", cell="second", source="others")
    history = [WANTS, *driven("a1", 1, 0, 2), cut, others, *driven("a2", 2, 4, 5)]
    assert returns(*history) == [(2, 2.0, True)]


DRAINED = event(2, "fault", what="cell_drained", cell="main")


@pytest.mark.parametrize(("cell", "begin_s"), [("main", 2), ("second", 1)])
def test_the_clock_begins_with_a_drain_for_the_robots_at_that_cell(cell: str, begin_s: float):
    at = event(0, "session", cell=cell, epoch=1)
    wants, leaves = event(1, "wants", what="ann"), event(6, "leaves", what="ann")
    history = [at, wants, DRAINED, *driven("a1", 1, 5, 6), leaves]
    assert returns(*history) == [(begin_s, 5.0 - begin_s, True)]


def test_a_drained_cell_is_live_when_it_alone_is_left():
    at = event(0, "session", cell="main", epoch=1)
    paused = event(3, "fault", what="cell_paused", cell="second")
    history = [at, WANTS, *driven("a1", 1, 0, 2), DRAINED, paused, *driven("a2", 2, 9, 10)]
    assert returns(*history, event(10, "leaves", what="ann")) == [(3, 6.0, True)]


def test_no_return_is_counted_without_a_live_cell():
    other = event(2, "fault", what="sshd_killed", cell="second")
    assert returns(WANTS, *driven("a1", 1, 0, 2), KILLED, other, LEAVES) == []


def test_without_a_database_a_cell_is_still_one():
    away = event(2, "fault", what="database_away")
    history = [WANTS, *driven("a1", 1, 0, 2), away, *driven("a2", 2, 5, 6)]
    left = event(6.1, "leaves", what="ann")
    assert returns(*history, left) == [(1.95, 3.05, True)]


def test_a_driver_who_gives_up():
    assert returns(WANTS, *driven("a1", 1, 0, 2), KILLED, LEAVES) == [(2, 98.0, False)]


def test_nobody_waits_while_nobody_wants_or_the_robot_is_stopped():
    left = event(2, "leaves", what="ann")
    again = event(50, "wants", what="ben")
    history = [WANTS, *driven("a1", 1, 0, 2), left, KILLED, again, *driven("b1", 2, 50.2, 51)]
    assert returns(*history) == []
    stop, release = event(2, "stop_asked"), event(60, "release_done")
    history = [WANTS, *driven("a1", 1, 0, 2), stop, release, *driven("a2", 2, 62, 63)]
    assert returns(*history) == [(60, 2.0, True)]


def test_what_is_written_is_read_in_order(tmp_path: Path):
    first, second = History.open(tmp_path, "robots"), History.open(tmp_path, "people")
    first.add("moved", robot="one", connection="ann", number=3)
    second.add("wants", robot="one", what="ann")
    first.add("zeroed", robot="one")
    for one in (first, second):
        one.close()
    # A process was killed while it wrote.
    with (tmp_path / "robots.jsonl").open("a") as file:
        file.write('{"at_s": 3')
    found = read(tmp_path)
    assert [(one.kind, one.source) for one in found] == [
        ("moved", "robots"),
        ("wants", "people"),
        ("zeroed", "robots"),
    ]
    assert found[0].number == 3


def test_a_crowd_is_the_most_robots_at_one_cell_and_passes():
    history = [
        event(0, "session", cell="main"),
        event(1, "session", robot="two", cell="second"),
        event(2, "session_lost", cell="main"),
        event(3, "session", cell="second"),
        event(4, "session", robot="two", cell="main"),
    ]
    assert find_crowds(history) == [2, 1]
    assert find_crowds([]) == [0, 0]
