"""What must hold of requests in every history, whatever breaks. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from robotether_server.services.planning import AWAY_AFTER_S, OFFER_S

from paper.cells.checker import Faults, Violation
from paper.cells.history import Event

# An offer whose operator is gone passes on within this time of its end.
PASSES_WITHIN_S = 1.0
# With one of these nobody can plan: without the database, or while the lock's holder hangs; and for a while after it.
NOBODY_PLANS = {"database_away", "database_cut", "cell_paused"}
AFTERMATH_S = 10.0
ENDS_OF_OFFERS = ("request_passed", "request_declined", "request_accepted")


@dataclass(frozen=True, kw_only=True)
class Record:
    """A line of the audit log on a request; the user is who was offered it, passed, declined, accepted or closed it."""

    at_s: float
    request: str
    kind: str
    user: str


@dataclass(frozen=True, kw_only=True)
class Records:
    """What the database has at the end: each request's state and who accepted it, and the log in its order."""

    requests: Mapping[str, tuple[str, str]]
    log: Sequence[Record]


def check(history: Sequence[Event], records: Records) -> list[Violation]:
    found = [*_lost(history, records), *_given_to_two(history, records), *_out_of_turn(records)]
    found += [
        Violation("late pass", "", end_s, f"an offer's end was noticed {late_s:.2f} s after it")
        for end_s, late_s in find_late_passes(history, records)
        if late_s > PASSES_WITHIN_S
    ]
    return sorted(found, key=lambda violation: violation.at_s)


def _lost(history: Sequence[Event], records: Records) -> Iterator[Violation]:
    """What the server said it had is there, and was answered once nothing was broken any more."""
    for event in history:
        if event.kind == "request_made":
            state, _ = records.requests.get(event.what, ("lost", ""))
            if state != "closed":
                words = f"request {event.what} is {state}"
                yield Violation("lost request", event.robot, event.at_s, words)


def _given_to_two(history: Sequence[Event], records: Records) -> Iterator[Violation]:
    """Whoever was told to have a request is the one whom the database has."""
    for event in history:
        if event.kind == "accepted":
            _, user = records.requests.get(event.what, ("lost", ""))
            if user != event.connection:
                words = f"request {event.what} was accepted by {event.connection} and is {user}'s"
                yield Violation("given to two", event.robot, event.at_s, words)


def _out_of_turn(records: Records) -> Iterator[Violation]:
    """An offer ends before the next begins, and is ended or accepted by its own user; no user has two."""
    users: dict[str, str] = {}
    for record in records.log:
        words = f"{record.kind} of request {record.request} by {record.user}"
        if record.kind == "request_offered":
            if record.request in users or record.user in users.values():
                yield Violation("given to two", "", record.at_s, f"{words}, beside {users}")
            users[record.request] = record.user
        elif record.kind in ENDS_OF_OFFERS and users.pop(record.request, "") != record.user:
            yield Violation("given to two", "", record.at_s, f"{words}, who had no offer of it")


def find_late_passes(history: Sequence[Event], records: Records) -> list[tuple[float, float]]:
    """When offers without an answer ended, and how much later they passed on, while somebody could plan."""
    polls: dict[str, list[float]] = {}
    for event in history:
        if event.kind == "polled":
            polls.setdefault(event.connection, []).append(event.at_s)
    broken = [fault for fault in Faults(history).all if fault.what in NOBODY_PLANS]
    offered_s: dict[str, float] = {}
    found = []
    for record in records.log:
        if record.kind == "request_offered":
            offered_s[record.request] = record.at_s
        elif record.kind == "request_passed":
            last_poll_s = max(
                (at_s for at_s in polls.get(record.user, []) if at_s < record.at_s), default=0.0
            )
            end_s = min(offered_s[record.request] + OFFER_S, last_poll_s + AWAY_AFTER_S)
            if not any(
                fault.begin_s <= record.at_s and fault.end_s + AFTERMATH_S >= end_s
                for fault in broken
            ):
                found.append((end_s, record.at_s - end_s))
    return found
