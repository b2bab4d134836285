"""A simulated queue of requests that the product's own `plan` decides on; beside it queueing theory and the optimum."""

from __future__ import annotations

import heapq
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, count
from random import Random

from robotether_server.services.planning import Operator, QueueState, WaitingRequest, plan

# All requests are of one robot, which every operator may drive.
ROBOT = 1
Pools = frozenset[str]


@dataclass(frozen=True)
class Job:
    """A request, and how long it keeps its operator, wrap-up and all."""

    made_s: float
    takes_s: float
    priority: int = 2
    pool: str = ""


def simulate(jobs: Sequence[Job], crew: Sequence[Pools], every_s: float = 0.0) -> list[float]:
    """Return how long each request waits when operators accept at once.

    A plan is made at the next multiple of `every_s` after a request is made or an operator is free; 0: at once.
    """
    operators = [
        Operator(user, "available", 0.0, pools, frozenset({ROBOT}))
        for user, pools in enumerate(crew)
    ]
    events = [(job.made_s, number, -1) for number, job in enumerate(jobs)]
    heapq.heapify(events)
    waiting: dict[int, WaitingRequest] = {}
    waited = [math.nan] * len(jobs)
    while events:
        now = events[0][0]
        now = math.ceil(now / every_s) * every_s if every_s else now
        while events and events[0][0] <= now:
            at_s, number, user = heapq.heappop(events)
            if user < 0:
                job = jobs[number]
                waiting[number] = WaitingRequest(number, ROBOT, job.priority, job.pool, at_s)
            else:
                operators[user] = replace(operators[user], state="available", idle_since=at_s)
        if not waiting:
            continue
        for offer in plan(QueueState(now, tuple(waiting.values()), (), tuple(operators))).offer:
            waited[offer.request_id] = now - waiting.pop(offer.request_id).since
            operators[offer.user_id] = replace(operators[offer.user_id], state="busy")
            ends_s = now + jobs[offer.request_id].takes_s
            heapq.heappush(events, (ends_s, offer.request_id, offer.user_id))
    return waited


def poisson_jobs(rng: Random, count: int, rate: float, mean_s: float) -> list[Job]:
    times = accumulate(rng.expovariate(rate) for _ in range(count))
    return [Job(at_s, rng.expovariate(1 / mean_s)) for at_s in times]


def erlang_c(operators: int, load: float) -> float:
    """Return the share of requests that wait at all, by Erlang's formula C; `load` is of one operator, below 1."""
    offered, blocked = operators * load, 1.0
    for busy in range(1, operators + 1):
        blocked = offered * blocked / (busy + offered * blocked)
    return blocked / (1 - load * (1 - blocked))


def waiting_quantile(operators: int, load: float, mean_s: float, part: float) -> float:
    """Return the waiting time below which this part of the requests stays, by the same theory."""
    late = erlang_c(operators, load) / (1 - part)
    return max(0.0, math.log(late) * mean_s / (operators * (1 - load)))


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
