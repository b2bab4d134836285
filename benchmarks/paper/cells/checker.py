"""What must hold in every history of cells, and how soon robots were drivable again. Pure.

    violations = check(history, database)
    returns = find_returns(history, cells)

A rule yields a violation for each event that breaks it, with the robot, the time and a sentence.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import Counter
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
    """What the database has at the end, by robots' names."""

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


def check(history: Sequence[Event], database: Database) -> list[Violation]:
    """All violations, in the order of time."""
    lateness = Lateness(history)
    found: list[Violation] = []
    for events in by_robot(history).values():
        found += [
            *_unknown_commands(events),
            *_interleaved_drivers(events),
            *_old_fences(events),
            *_shared_fences(events),
            *_moves_while_stopped(events, lateness),
            *_releases_of_nobody(events),
            *_unattended_motion(events, lateness, history[-1].at_s),
            *_old_epochs(events),
        ]
    found += _lost_records(history, database)
    found += _wrong_stops(history, database)
    found += _several_sessions(history, database)
    return sorted(found, key=lambda one: one.at_s)


class Lateness:
    """How long each process was held up, by its own measure."""

    def __init__(self, history: Sequence[Event]) -> None:
        self._late: dict[str, list[tuple[float, float]]] = {}
        for one in history:
            if one.kind == "late":
                self._late.setdefault(one.source, []).append((one.at_s, one.number / 1000))

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
    return {(one.connection, one.number): one.fence for one in events if one.kind == "arrived"}


def _moved(events: Iterable[Event]) -> Iterator[Event]:
    return (one for one in events if one.kind == "moved")


def _unknown_commands(events: Sequence[Event]) -> Iterator[Violation]:
    """A robot moves by commands alone that its guard got."""
    known = fences_of(events)
    for one in _moved(events):
        if (one.connection, one.number) not in known:
            words = f"command {one.number} of {one.connection} never came to the guard"
            yield Violation("unknown command", one.robot, one.at_s, words)


def _interleaved_drivers(events: Sequence[Event]) -> Iterator[Violation]:
    """A connection whose command was followed by another's never moves the robot again."""
    over: set[str] = set()
    now = ""
    for one in _moved(events):
        if one.connection in over:
            words = f"{one.connection} moves it after {now}, which came after it"
            yield Violation("two drivers", one.robot, one.at_s, words)
        elif one.connection != now:
            over |= {now} - {""}
            now = one.connection


def _old_fences(events: Sequence[Event]) -> Iterator[Violation]:
    """A command never moves a robot after one of a newer fence did."""
    fences = fences_of(events)
    newest = 0
    for one in _moved(events):
        fence = fences.get((one.connection, one.number), newest)
        if fence < newest:
            words = f"a command of fence {fence} moves it after one of fence {newest}"
            yield Violation("old fence", one.robot, one.at_s, words)
        newest = max(newest, fence)


def _shared_fences(events: Sequence[Event]) -> Iterator[Violation]:
    """No two connections are ever given one number."""
    owners: dict[int, str] = {}
    known: set[tuple[int, str]] = set()
    for one in events:
        if one.kind != "arrived" or not one.fence or (one.fence, one.connection) in known:
            continue
        known.add((one.fence, one.connection))
        owner = owners.setdefault(one.fence, one.connection)
        if owner != one.connection:
            words = f"fence {one.fence} was given to {owner} and to {one.connection}"
            yield Violation("shared fence", one.robot, one.at_s, words)


def _moves_while_stopped(events: Sequence[Event], lateness: Lateness) -> Iterator[Violation]:
    """Once a stop is confirmed, by the guard or to who asked, nothing moves until a release."""
    # When it was confirmed, and until when a command may still have been under way in the robot; by whom it was.
    stopped: dict[str, float] = {}
    for one in events:
        if one.kind == "stopped":
            stopped.setdefault("its guard", one.at_s)
        elif one.kind == "stop_done" and one.number:
            stopped.setdefault("the server", one.at_s)
        elif one.kind == "released":
            stopped.pop("its guard", None)
        elif one.kind == "release_asked":
            stopped.pop("the server", None)
        elif one.kind == "moved":
            for who, at_s in stopped.items():
                late_s = lateness.between(one.source, at_s, one.at_s)
                if one.at_s > at_s + TOLERANCE_S + late_s:
                    words = (
                        f"{one.connection} moves it {one.at_s - at_s:.2f} s after {who} confirmed"
                    )
                    yield Violation("stop undone", one.robot, one.at_s, f"{words} a stop")


def _releases_of_nobody(events: Sequence[Event]) -> Iterator[Violation]:
    """A guard releases a robot only for who asked, and not when a stop came between and was confirmed."""
    asked_s = done_s = -1.0
    stop_asked_s = -1.0
    for one in events:
        if one.kind == "release_asked":
            asked_s = one.at_s
        elif one.kind == "stop_asked":
            stop_asked_s = one.at_s
        elif one.kind == "stop_done" and stop_asked_s > asked_s:
            done_s = one.at_s
        elif one.kind == "released" and (asked_s < 0 or done_s > asked_s):
            words = (
                "its guard released it, and nobody had asked"
                if asked_s < 0
                else f"its guard released it, asked {one.at_s - asked_s:.2f} s ago, before a stop "
                f"that was confirmed {one.at_s - done_s:.2f} s ago"
            )
            yield Violation("release of nobody", one.robot, one.at_s, words)


def _unattended_motion(
    events: Sequence[Event], lateness: Lateness, end_s: float
) -> Iterator[Violation]:
    """A command that moves is followed by another, or by a zero, within the deadman's time."""
    moving: Event | None = None
    guard_changed = False
    for one in events:
        if one.kind in ("guard_killed", "guard_began"):
            guard_changed = True
        elif one.kind in ("moved", "zeroed"):
            yield from _too_long(moving, one.at_s, lateness, guard_changed=guard_changed)
            moving, guard_changed = one if one.kind == "moved" else None, False
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
    for one in events:
        if one.kind == "session" and one.epoch:
            if one.epoch <= newest:
                words = f"its session at {one.cell} has epoch {one.epoch}, one before had {newest}"
                yield Violation("old epoch", one.robot, one.at_s, words)
            newest = max(newest, one.epoch)


def _lost_records(history: Sequence[Event], database: Database) -> Iterator[Violation]:
    """What the server said it had is in the database, whatever was killed meanwhile."""
    for one, what, is_there in _records(history, database):
        if not is_there:
            yield Violation("lost record", one.robot, one.at_s, f"the database has no {what}")


def _records(history: Sequence[Event], database: Database) -> Iterator[tuple[Event, str, bool]]:
    """What the database must have: by which event, what it is, and whether it is there."""
    for robot, events in by_robot(history).items():
        fences, seen = fences_of(events), set[int]()
        for one in events:
            if one.kind == "stop_done" and one.what:
                is_there = one.what in database.stop_reasons
                yield one, f"audit line of the stop {one.what!r}", is_there
            if one.kind != "moved":
                continue
            fence = fences.get((one.connection, one.number), 0)
            if fence in seen or not fence:
                continue
            seen.add(fence)
            yield one, f"drive with fence {fence}", (robot, fence) in database.drives
            is_there = database.fences.get(robot, 0) >= fence
            yield one, f"fence as high as {fence}", is_there
    for one in history:
        if one.kind == "recorded":
            yield one, f"record {one.what!r}", one.what in database.recorded


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
        self.source = next((one.source for one in events if one.kind in ("session", "moved")), "")
        self._sessions = [one for one in events if one.kind == "session"]

    def has_to_leave(self, fault: _Fault) -> bool:
        """Whether a fault takes a cell, or drains one that the robot was at."""
        if fault.what == CELL_DRAINED:
            return fault.cell in self._cells_in(fault.begin_s, fault.end_s)
        return fault.what in CELL_GONE

    def _cells_in(self, begin_s: float, end_s: float) -> set[str]:
        """Where it was then, and where its newest session before was, to which it connects first."""
        first = bisect_right(self._sessions, begin_s, key=lambda one: one.at_s)
        last = bisect_right(self._sessions, end_s, key=lambda one: one.at_s)
        return {one.cell for one in self._sessions[max(0, first - 1) : last]}


class Faults:
    """What the nemesis did, with begin and end."""

    def __init__(self, history: Sequence[Event]) -> None:
        self.all: list[_Fault] = []
        begun: dict[tuple[str, str, str], float] = {}
        for one in history:
            key = (one.what, one.cell, one.source)
            if one.kind == "fault":
                begun.setdefault(key, one.at_s)
            elif one.kind == "healed" and key in begun:
                self.all.append(_Fault(*key, begun.pop(key), one.at_s))
        self.all += [_Fault(*key, at_s, float("inf")) for key, at_s in begun.items()]

    def of_cell(self, cell: str, source: str = "") -> Iterator[_Fault]:
        """Those that concern a cell, as the robots of a process see it."""
        return (
            one
            for one in self.all
            if one.cell in ("", cell) and (not one.source or one.source == source)
        )

    def is_live(self, cell: str, source: str, at_s: float) -> bool:
        """Whether the robots of a process could use a cell then."""
        return not any(
            one.what in CELL_GONE and one.begin_s <= at_s < one.end_s
            for one in self.of_cell(cell, source)
        )

    def last_change(
        self, cells: Sequence[str], robot: Whereabouts, begin_s: float, end_s: float
    ) -> tuple[float, str]:
        """The last moment until `end_s`, at the earliest `begin_s`, that a robot has to begin anew from, and why.

        That is a fault which takes a cell, a drain of the robot's own, or the return of the first one that is live.
        """
        # A fault is written down before it is done, and may be what the robot's last command came after.
        open_ones = [
            (one.begin_s, one.what)
            for one in self.all
            if one.begin_s <= begin_s <= one.end_s
            and robot.has_to_leave(one)
            and one.source in ("", robot.source)
        ]
        last = (begin_s, max(open_ones, default=(0.0, ""))[1])
        for cell in cells:
            for one in self.of_cell(cell, robot.source):
                if not robot.has_to_leave(one):
                    continue
                if one.begin_s <= end_s:
                    last = max(last, (one.begin_s, one.what))
                before_s = one.end_s - 0.001
                if one.end_s <= end_s and not self.any_live(cells, robot.source, before_s):
                    last = max(last, (one.end_s, f"end of {one.what}"))
        return last

    def any_live(self, cells: Sequence[str], source: str, at_s: float) -> bool:
        """Whether the robots of a process had a live cell then."""
        return any(self.is_live(cell, source, at_s) for cell in cells)


def _wrong_stops(history: Sequence[Event], database: Database) -> Iterator[Violation]:
    """The database says of each robot what its last stop or release came to."""
    last: dict[str, Event] = {}
    for one in history:
        if one.kind in ("stop_asked", "stop_done", "release_asked", "release_done"):
            last[one.robot] = one
    for robot, one in last.items():
        if one.kind == "stop_done" and robot not in database.stopped:
            words = "its last stop was confirmed, and the database does not have it"
            yield Violation("stop undone", robot, one.at_s, words)
        elif one.kind == "release_done" and robot in database.stopped:
            words = "its last release was confirmed, and the database has it stopped"
            yield Violation("release undone", robot, one.at_s, words)


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
        for one in [*events, Event(at_s=0, kind="release_asked")]:
            if one.kind == "stop_done" and not one.number:
                done, moved_s = one, 0.0
            elif one.kind == "moved" and done is not None:
                moved_s = one.at_s - done.at_s
            elif one.kind in ("stopped", "release_asked", "stop_done"):
                found += [moved_s] * (done is not None and moved_s > TOLERANCE_S)
                done = None
    return found


def find_crowds(history: Sequence[Event]) -> list[int]:
    """How many robots were at one cell at most, and at the end."""
    where: dict[str, str] = {}
    most = last = 0
    for one in history:
        if one.kind == "session":
            where[one.robot] = one.cell
        elif one.kind == "session_lost":
            where.pop(one.robot, None)
        else:
            continue
        last = max(Counter(where.values()).values(), default=0)
        most = max(most, last)
    return [most, last]


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
    wish = _Wish()
    for one in [*events, Event(at_s=end_s, kind="late")]:
        since_s, waits = wish.since_s, wish.waits
        wish.follow(one)
        ends = one.kind in ("moved", "late") or (one.kind == "leaves" and wish.since_s is None)
        if not (ends and waits and faults.any_live(cells, whereabouts.source, one.at_s)):
            continue
        begin_s, after = faults.last_change(cells, whereabouts, since_s or one.at_s, one.at_s)
        if one.at_s - begin_s > OUTAGE_S:
            yield Return(robot, begin_s, one.at_s - begin_s, one.kind == "moved", after)


class _Wish:
    """Since when a robot is not driven, though somebody wants to."""

    def __init__(self) -> None:
        self.since_s: float | None = None
        self._drivers: set[str] = set()
        self._is_stopped = False

    @property
    def waits(self) -> bool:
        return self.since_s is not None and not self._is_stopped

    def follow(self, one: Event) -> None:
        if one.kind == "wants":
            self.since_s = self.since_s if self._drivers else one.at_s
            self._drivers.add(one.what)
        elif one.kind == "leaves":
            self._drivers.discard(one.what)
            self.since_s = self.since_s if self._drivers else None
        elif one.kind in ("stop_asked", "stopped"):
            self._is_stopped = True
        elif one.kind in ("moved", "released", "release_done"):
            self._is_stopped = self._is_stopped and one.kind == "moved"
            self.since_s = one.at_s if self._drivers else None
