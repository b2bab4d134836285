"""The least priority-weighted waiting that any schedule reaches which knows all requests beforehand. Pure.

A search through all schedules that may be best: a request begins when it is made, or when an operator becomes free.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count

from paper.requests.simulation import Job, Pools

# What a second of waiting costs, by priority.
WEIGHTS: Mapping[int, int] = {1: 4, 2: 2, 3: 1}


def weighted_waiting(jobs: Sequence[Job], waited: Sequence[float]) -> float:
    """Return the sum over all requests of weight times seconds from made to accepted."""
    return sum(WEIGHTS[job.priority] * wait for job, wait in zip(jobs, waited, strict=True))


@dataclass(frozen=True)
class _State:
    """What the best rest of a schedule depends on; requests are numbers in the order of time."""

    now: float
    # The first request that is not made yet.
    next: int
    waiting: tuple[int, ...]
    # How many operators of each kind are free, and when the others will be: (time, kind).
    free: tuple[int, ...]
    busy: tuple[tuple[float, int], ...]


def least_waiting(jobs: Sequence[Job], operators: Sequence[Pools]) -> float:
    """Return the least `weighted_waiting`; all requests must take equally long."""
    if len({job.takes_s for job in jobs}) > 1:
        raise ValueError(
            "cannot search: requests take different times, so that their order matters"
        )
    jobs = sorted(jobs, key=lambda job: job.made_s)
    kinds = Counter(operators)
    pools = list(kinds)

    # The cheapest moment first: the first that leaves nothing to do has the least.
    start = _arrived(_State(0.0, 0, (), tuple(kinds.values()), ()), jobs)
    numbers, seen = count(), set[_State]()
    states = [(0.0, 0.0, next(numbers), start)]
    while True:
        cost, _, _, at = heapq.heappop(states)
        if at in seen:
            continue
        seen.add(at)
        steps = [(cost, begun) for begun in _begun(at, jobs, pools)]
        if (later := _later(at, jobs)) is not None:
            cost_a_second = sum(WEIGHTS[jobs[number].priority] for number in at.waiting)
            steps.append((cost + cost_a_second * (later.now - at.now), later))
        elif not at.waiting:
            return cost
        for step_cost, step in steps:
            heapq.heappush(states, (step_cost, -step.now, next(numbers), step))


def _begun(at: _State, jobs: Sequence[Job], pools: Sequence[Pools]) -> Iterator[_State]:
    """Yield the moment after each way to give a waiting request to a free operator, the oldest of its like."""
    likes = {(jobs[number].priority, jobs[number].pool): number for number in reversed(at.waiting)}
    for (_, pool), number in likes.items():
        for kind, free_ones in enumerate(at.free):
            if free_ones and (pool == "" or pool in pools[kind]):
                free = (*at.free[:kind], free_ones - 1, *at.free[kind + 1 :])
                busy = tuple(sorted((*at.busy, (at.now + jobs[number].takes_s, kind))))
                waiting = tuple(other for other in at.waiting if other != number)
                yield _State(at.now, at.next, waiting, free, busy)


def _later(at: _State, jobs: Sequence[Job]) -> _State | None:
    """Return the moment of the next change; None: there is none, or nothing would wait for it."""
    times = [at_s for at_s, _ in at.busy] if at.waiting else []
    times += [jobs[at.next].made_s] if at.next < len(jobs) else []
    if not times:
        return None
    now = min(times)
    free = list(at.free)
    for at_s, kind in at.busy:
        free[kind] += at_s <= now
    busy = tuple(entry for entry in at.busy if entry[0] > now)
    return _arrived(_State(now, at.next, at.waiting, tuple(free), busy), jobs)


def _arrived(at: _State, jobs: Sequence[Job]) -> _State:
    made = sum(job.made_s <= at.now for job in jobs)
    return _State(at.now, made, (*at.waiting, *range(at.next, made)), at.free, at.busy)
