"""A simulated queue of requests that the product's own `plan` decides on, and what queueing theory says of it. Pure."""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
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
        now = _planned_at(events[0][0], every_s)
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


def _planned_at(at_s: float, every_s: float) -> float:
    return math.ceil(at_s / every_s) * every_s if every_s else at_s


def poisson_jobs(rng: Random, count: int, rate: float, mean_s: float) -> list[Job]:
    """Return requests that come by chance at a rate, and take an exponential time."""
    times = accumulate(rng.expovariate(rate) for _ in range(count))
    return [Job(at_s, rng.expovariate(1 / mean_s)) for at_s in times]


def erlang_c(operators: int, load: float) -> float:
    """Return the share of requests that wait at all, by Erlang's formula C; `load` is of one operator, below 1."""
    offered, blocked = operators * load, 1.0
    for count in range(1, operators + 1):
        blocked = offered * blocked / (count + offered * blocked)
    return blocked / (1 - load * (1 - blocked))


def waiting_quantile(operators: int, load: float, mean_s: float, part: float) -> float:
    """Return the waiting time below which this part of the requests stays, by the same theory."""
    late = erlang_c(operators, load) / (1 - part)
    return max(0.0, math.log(late) * mean_s / (operators * (1 - load)))
