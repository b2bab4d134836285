"""What must hold in every history of cells, and how soon robots were drivable again. Pure.

A rule yields a violation for each event that breaks it, with the robot, the time and a sentence.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from paper.cells.history import Event, by_robot

# A guard stops a robot whose driver is silent for 0.5 s, and knows it by the next turn of its loop.
DEADMAN_S, TURN_S = 0.5, 0.01
# A guard that dies in motion is followed by one that stops the robot within a second.
NEXT_GUARD_S = 1.0
# What a message needs within a robot on a machine that is busy; what held its process up is added, as it was measured.
TOLERANCE_S = 0.1
# Commands come every 50 ms.
OUTAGE_S = 0.6
# With one of these, a cell is none for the robots that are concerned. Without a database it still is one.
CELL_GONE = {
    "cell_killed",
    "relay_killed",
    "cell_paused",
    "sshd_killed",
    "relay_restarted",
    "robots_cut",
    "disk_full",
    # Its tickets are no other's.
    "clock_stepped",
}
# A drained cell still is one: who has no other is driven there. But the robots at it have to begin anew elsewhere.
CELL_DRAINED = "cell_drained"


@dataclass(frozen=True)
class Violation:
    """A rule was broken; `at_s` is of the history's clock."""

    rule: str
    robot: str
    at_s: float
    words: str


@dataclass(frozen=True, kw_only=True)
class Database:
    drives: Collection[tuple[str, int]] = ()
    # The newest number of each robot.
    fences: Mapping[str, int] = field(default_factory=dict)
    # The reasons in the audit log's lines of stops, and what else was recorded with such a line.
    stop_reasons: Collection[str] = ()
    recorded: Collection[str] = ()
    # Robots that are stopped, and how many open sessions each has.
    stopped: Collection[str] = ()
    open_sessions: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Return:
    """A robot whom somebody wanted to drive, and could not for a while."""

    robot: str
    # When a live cell was there and nothing stood in the way any more.
    at_s: float
    took_s: float
    # Whether it was driven at the end of it; else its driver gave up.
    came: bool
    # The fault that it begins with, or with whose end.
    after: str = ""


def check(history: Sequence[Event], database: Database, follower: str = "") -> list[Violation]:
    """All violations, in the order of time; `follower` is driven by a route, which has one lease for all commands."""
    lateness = Lateness(history)
    found: list[Violation] = []
    for robot, events in by_robot(history).items():
        found += [
            *_unknown_commands(events),
            *_interleaved_drivers(events),
            *_old_fences(events),
            *([] if robot == follower else _shared_fences(events)),
            *_moves_while_stopped(events, lateness),
            *_releases_of_nobody(events),
            *_unattended_motion(events, lateness, history[-1].at_s),
            *_old_epochs(events),
        ]
    found += _lost_records(history, database)
    found += _wrong_stops(history, database)
    found += _several_sessions(history, database)
    return sorted(found, key=lambda item: item.at_s)


class Lateness:
    """How long each process was held up, by its own measure."""

    def __init__(self, history: Sequence[Event]) -> None:
        self._late: dict[str, list[tuple[float, float]]] = {}
        for event in history:
            if event.kind == "late":
                self._late.setdefault(event.source, []).append((event.at_s, event.number / 1000))

    def between(self, source: str, first_s: float, last_s: float) -> float:
        """Seconds in all, of what ended from then on, or shortly after."""
        late = self._late.get(source, [])
        begin = bisect_left(late, (first_s, 0.0))
        total = 0.0
        for at_s, late_s in late[begin:]:
            if at_s - late_s > last_s:
                break
            total += late_s
        return total


def fences_of(events: Iterable[Event]) -> dict[tuple[str, int], int]:
    """The fence with which each command came to the guard, by connection and number."""
    return {
        (event.connection, event.number): event.fence for event in events if event.kind == "arrived"
    }


def _moved(events: Iterable[Event]) -> Iterator[Event]:
    return (event for event in events if event.kind == "moved")


def _unknown_commands(events: Sequence[Event]) -> Iterator[Violation]:
    """A robot moves by commands alone that its guard got."""
    known = fences_of(events)
    for move in _moved(events):
        if (move.connection, move.number) not in known:
            words = f"command {move.number} of {move.connection} never came to the guard"
            yield Violation("unknown command", move.robot, move.at_s, words)


def _interleaved_drivers(events: Sequence[Event]) -> Iterator[Violation]:
    """A connection whose command was followed by another's never moves the robot again."""
    over: set[str] = set()
    now = ""
    for move in _moved(events):
        if move.connection in over:
            words = f"{move.connection} moves it after {now}, which came after it"
            yield Violation("two drivers", move.robot, move.at_s, words)
        elif move.connection != now:
            over |= {now} - {""}
            now = move.connection


def _old_fences(events: Sequence[Event]) -> Iterator[Violation]:
    """A command never moves a robot after one of a newer fence did."""
    fences = fences_of(events)
    newest = 0
    for move in _moved(events):
        fence = fences.get((move.connection, move.number), newest)
        if fence < newest:
            words = f"a command of fence {fence} moves it after one of fence {newest}"
            yield Violation("old fence", move.robot, move.at_s, words)
        newest = max(newest, fence)


def _shared_fences(events: Sequence[Event]) -> Iterator[Violation]:
    """No two connections are ever given one number."""
    owners: dict[int, str] = {}
    known: set[tuple[int, str]] = set()
    for event in events:
        if event.kind != "arrived" or not event.fence or (event.fence, event.connection) in known:
            continue
        known.add((event.fence, event.connection))
        owner = owners.setdefault(event.fence, event.connection)
        if owner != event.connection:
            words = f"fence {event.fence} was given to {owner} and to {event.connection}"
            yield Violation("shared fence", event.robot, event.at_s, words)


def _moves_while_stopped(events: Sequence[Event], lateness: Lateness) -> Iterator[Violation]:
    """Once a stop is confirmed, by the guard or to who asked, nothing moves until a release."""
    # When it was confirmed, and until when a command may still have been under way in the robot; by whom it was.
    stopped: dict[str, float] = {}
    for event in events:
        if event.kind == "stopped":
            stopped.setdefault("its guard", event.at_s)
        elif event.kind == "stop_done" and event.number:
            stopped.setdefault("the server", event.at_s)
        elif event.kind == "released":
            stopped.pop("its guard", None)
        elif event.kind == "release_asked":
            stopped.pop("the server", None)
        elif event.kind == "moved":
            for who, at_s in stopped.items():
                late_s = lateness.between(event.source, at_s, event.at_s)
                if event.at_s > at_s + TOLERANCE_S + late_s:
                    words = f"{event.connection} moves it {event.at_s - at_s:.2f} s after {who} confirmed"
                    yield Violation("stop undone", event.robot, event.at_s, f"{words} a stop")


def _releases_of_nobody(events: Sequence[Event]) -> Iterator[Violation]:
    """A guard releases a robot only for who asked, and not when a stop came between and was confirmed."""
    asked_s = done_s = -1.0
    stop_asked_s = -1.0
    for event in events:
        if event.kind == "release_asked":
            asked_s = event.at_s
        elif event.kind == "stop_asked":
            stop_asked_s = event.at_s
        elif event.kind == "stop_done" and stop_asked_s > asked_s:
            done_s = event.at_s
        elif event.kind == "released" and (asked_s < 0 or done_s > asked_s):
            why = "nobody had asked"
            if asked_s >= 0:
                why = f"the stop that was confirmed {event.at_s - done_s:.2f} s ago is newer"
            words = f"its guard released it, and {why}"
            yield Violation("release of nobody", event.robot, event.at_s, words)


def _unattended_motion(
    events: Sequence[Event], lateness: Lateness, end_s: float
) -> Iterator[Violation]:
    """A command that moves is followed by another, or by a zero, within the deadman's time."""
    moving: Event | None = None
    guard_changed = False
    for event in events:
        if event.kind in ("guard_killed", "guard_began"):
            guard_changed = True
        elif event.kind in ("moved", "zeroed"):
            yield from _too_long(moving, event.at_s, lateness, guard_changed=guard_changed)
            moving, guard_changed = event if event.kind == "moved" else None, False
    yield from _too_long(moving, end_s, lateness, guard_changed=guard_changed)


def _too_long(
    moving: Event | None, until_s: float, lateness: Lateness, *, guard_changed: bool
) -> Iterator[Violation]:
    if moving is None:
        return
    allowed_s = DEADMAN_S + TURN_S + TOLERANCE_S + (NEXT_GUARD_S if guard_changed else 0)
    allowed_s += lateness.between(moving.source, moving.at_s, until_s)
    if until_s - moving.at_s > allowed_s:
        words = f"it moved for {until_s - moving.at_s:.2f} s after the last command, {allowed_s:.2f} s are allowed"
        yield Violation("moves without a driver", moving.robot, moving.at_s, words)


def _old_epochs(events: Sequence[Event]) -> Iterator[Violation]:
    """Each session of a robot has a higher epoch than the one before."""
    newest = 0
    for event in events:
        if event.kind == "session" and event.epoch:
            if event.epoch <= newest:
                words = (
                    f"its session at {event.cell} has epoch {event.epoch}, one before had {newest}"
                )
                yield Violation("old epoch", event.robot, event.at_s, words)
            newest = max(newest, event.epoch)


def _lost_records(history: Sequence[Event], database: Database) -> Iterator[Violation]:
    """What the server said it had is in the database, whatever was killed meanwhile."""
    for event, what, is_there in _records(history, database):
        if not is_there:
            yield Violation("lost record", event.robot, event.at_s, f"the database has no {what}")


def _records(history: Sequence[Event], database: Database) -> Iterator[tuple[Event, str, bool]]:
    """What the database must have: by which event, what it is, and whether it is there."""
    for robot, events in by_robot(history).items():
        fences, seen = fences_of(events), set[int]()
        for event in events:
            if event.kind == "stop_done" and event.what:
                is_there = event.what in database.stop_reasons
                yield event, f"audit line of the stop {event.what!r}", is_there
            if event.kind != "moved":
                continue
            fence = fences.get((event.connection, event.number), 0)
            if fence in seen or not fence:
                continue
            seen.add(fence)
            yield event, f"drive with fence {fence}", (robot, fence) in database.drives
            is_there = database.fences.get(robot, 0) >= fence
            yield event, f"fence as high as {fence}", is_there
    for event in history:
        if event.kind == "recorded":
            yield event, f"record {event.what!r}", event.what in database.recorded


@dataclass(frozen=True)
class _Fault:
    what: str
    cell: str
    source: str
    begin_s: float
    end_s: float


class Whereabouts:
    """The process that plays a robot, and at which cells it was."""

    def __init__(self, events: Sequence[Event]) -> None:
        self.source = next(
            (event.source for event in events if event.kind in ("session", "moved")), ""
        )
        self._sessions = [event for event in events if event.kind == "session"]

    def has_to_leave(self, fault: _Fault) -> bool:
        """Whether a fault takes a cell, or drains one that the robot was at."""
        if fault.what == CELL_DRAINED:
            return fault.cell in self._cells_in(fault.begin_s, fault.end_s)
        return fault.what in CELL_GONE

    def _cells_in(self, begin_s: float, end_s: float) -> set[str]:
        """Where it was then, and where its newest session before was, to which it connects first."""
        first = bisect_right(self._sessions, begin_s, key=lambda session: session.at_s)
        last = bisect_right(self._sessions, end_s, key=lambda session: session.at_s)
        return {session.cell for session in self._sessions[max(0, first - 1) : last]}


class Faults:
    """What the nemesis did, with begin and end."""

    def __init__(self, history: Sequence[Event]) -> None:
        self.all: list[_Fault] = []
        begun: dict[tuple[str, str, str], float] = {}
        for event in history:
            key = (event.what, event.cell, event.source)
            if event.kind == "fault":
                begun.setdefault(key, event.at_s)
            elif event.kind == "healed" and key in begun:
                self.all.append(_Fault(*key, begun.pop(key), event.at_s))
        self.all += [_Fault(*key, at_s, float("inf")) for key, at_s in begun.items()]

    def of_cell(self, cell: str, source: str = "") -> Iterator[_Fault]:
        """Those that concern a cell, as the robots of a process see it."""
        return (
            item
            for item in self.all
            if item.cell in ("", cell) and (not item.source or item.source == source)
        )

    def is_live(self, cell: str, source: str, at_s: float) -> bool:
        return not any(
            item.what in CELL_GONE and item.begin_s <= at_s < item.end_s
            for item in self.of_cell(cell, source)
        )

    def last_change(
        self, cells: Sequence[str], robot: Whereabouts, begin_s: float, end_s: float
    ) -> tuple[float, str]:
        """The last moment until `end_s`, at the earliest `begin_s`, that a robot has to begin anew from, and why.

        That is a fault which takes a cell, a drain of the robot's own, or the return of the first one that is live.
        """
        # A fault is written down before it is done, and may be what the robot's last command came after.
        open_ones = [
            (item.begin_s, item.what)
            for item in self.all
            if item.begin_s <= begin_s <= item.end_s
            and robot.has_to_leave(item)
            and item.source in ("", robot.source)
        ]
        last = (begin_s, max(open_ones, default=(0.0, ""))[1])
        for cell in cells:
            for item in self.of_cell(cell, robot.source):
                if not robot.has_to_leave(item):
                    continue
                if item.begin_s <= end_s:
                    last = max(last, (item.begin_s, item.what))
                before_s = item.end_s - 0.001
                if item.end_s <= end_s and not self.any_live(cells, robot.source, before_s):
                    last = max(last, (item.end_s, f"end of {item.what}"))
        return last

    def any_live(self, cells: Sequence[str], source: str, at_s: float) -> bool:
        return any(self.is_live(cell, source, at_s) for cell in cells)


def _wrong_stops(history: Sequence[Event], database: Database) -> Iterator[Violation]:
    """The database says of each robot what its last stop or release came to."""
    last: dict[str, Event] = {}
    for event in history:
        if event.kind in ("stop_asked", "stop_done", "release_asked", "release_done"):
            last[event.robot] = event
    for robot, item in last.items():
        if item.kind == "stop_done" and robot not in database.stopped:
            words = "its last stop was confirmed, and the database does not have it"
            yield Violation("stop undone", robot, item.at_s, words)
        elif item.kind == "release_done" and robot in database.stopped:
            words = "its last release was confirmed, and the database has it stopped"
            yield Violation("release undone", robot, item.at_s, words)


def _several_sessions(history: Sequence[Event], database: Database) -> Iterator[Violation]:
    for robot, count in database.open_sessions.items():
        if count > 1:
            words = f"the database has {count} open sessions of it"
            yield Violation("several sessions", robot, history[-1].at_s, words)


def find_ignored_stops(history: Sequence[Event]) -> list[float]:
    """For how long robots were moved after stops that the server took and no guard had confirmed."""
    found: list[float] = []
    for events in by_robot(history).values():
        done: Event | None = None
        moved_s = 0.0
        for event in [*events, Event(at_s=0, kind="release_asked")]:
            if event.kind == "stop_done" and not event.number:
                done, moved_s = event, 0.0
            elif event.kind == "moved" and done is not None:
                moved_s = event.at_s - done.at_s
            elif event.kind in ("stopped", "release_asked", "stop_done"):
                found += [moved_s] * (done is not None and moved_s > TOLERANCE_S)
                done = None
    return found


def find_returns(history: Sequence[Event], cells: Sequence[str]) -> list[Return]:
    """Each time that a robot could not be driven by who wanted to, though a live cell was there."""
    faults = Faults(history)
    end_s = history[-1].at_s if history else 0.0
    return [
        found
        for robot, events in by_robot(history).items()
        for found in _returns_of(robot, events, faults, cells, end_s)
    ]


def _returns_of(
    robot: str, events: Sequence[Event], faults: Faults, cells: Sequence[str], end_s: float
) -> Iterator[Return]:
    whereabouts = Whereabouts(events)
    request = _ControlRequest()
    for event in [*events, Event(at_s=end_s, kind="late")]:
        since_s, waits = request.since_s, request.waits
        request.follow(event)
        ends = event.kind in ("moved", "late") or (
            event.kind == "leaves" and request.since_s is None
        )
        if not (ends and waits and faults.any_live(cells, whereabouts.source, event.at_s)):
            continue
        begin_s, after = faults.last_change(cells, whereabouts, since_s or event.at_s, event.at_s)
        if event.at_s - begin_s > OUTAGE_S:
            yield Return(robot, begin_s, event.at_s - begin_s, event.kind == "moved", after)


class _ControlRequest:
    """Since when a robot is not driven, though somebody wants to."""

    def __init__(self) -> None:
        self.since_s: float | None = None
        self._drivers: set[str] = set()
        self._is_stopped = False

    @property
    def waits(self) -> bool:
        return self.since_s is not None and not self._is_stopped

    def follow(self, item: Event) -> None:
        if item.kind == "wants":
            self.since_s = self.since_s if self._drivers else item.at_s
            self._drivers.add(item.what)
        elif item.kind == "leaves":
            self._drivers.discard(item.what)
            self.since_s = self.since_s if self._drivers else None
        elif item.kind in ("stop_asked", "stopped"):
            self._is_stopped = True
        elif item.kind in ("moved", "released", "release_done"):
            self._is_stopped = self._is_stopped and item.kind == "moved"
            self.since_s = item.at_s if self._drivers else None
