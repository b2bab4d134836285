"""The least expected weighted waiting of any planner that does not know the future, in small queues. Pure.

Time goes in steps, and in each at most one request is made, by chance. So a queue has few states, and the best decision
in each follows from what it leads to (dynamic programming). Nobody who plans without foresight can do better.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from random import Random

from paper.requests.optimum import WEIGHTS
from paper.requests.simulation import Job, Pools

# How many requests of each kind wait.
Waiting = tuple[int, ...]
# In how many steps each operator is free.
Busy = tuple[int, ...]


@dataclass(frozen=True)
class SmallQueue:
    """Operators, and requests that come by chance; `kinds` has the share of each priority and pool."""

    operators: Sequence[Pools]
    kinds: Mapping[tuple[int, str], float]
    requests: int
    step_s: float
    # How many steps a request keeps its operator.
    takes: int
    # The probability that a request is made in a step.
    chance: float

    def jobs(self, rng: Random) -> list[Job]:
        jobs: list[Job] = []
        step = 0
        while len(jobs) < self.requests:
            if rng.random() < self.chance:
                [(priority, pool)] = rng.choices(list(self.kinds), list(self.kinds.values()))
                jobs.append(Job(step * self.step_s, self.takes * self.step_s, priority, pool))
            step += 1
        return jobs


class BestPlanner:
    """Decides in each step what leads to the least waiting on average; knows the chances, and nothing else."""

    def __init__(self, queue: SmallQueue) -> None:
        self._queue = queue
        self._kinds = sorted(queue.kinds)
        self._shares = [queue.kinds[kind] for kind in self._kinds]
        self._costs = [WEIGHTS[priority] for priority, _ in self._kinds]
        # Operators of the same pools are alike.
        self._are_alike = len(set(queue.operators)) == 1
        self._known: dict[tuple[int, Waiting, Busy], float] = {}

    def weighted_waiting(self, jobs: Sequence[Job]) -> float:
        """Return the weighted waiting, in seconds, of these requests of the queue."""
        kinds = {
            round(job.made_s / self._queue.step_s): self._kinds.index((job.priority, job.pool))
            for job in jobs
        }
        waiting, busy = (0,) * len(self._kinds), (0,) * len(self._queue.operators)
        cost, step, left = 0, 0, len(jobs)
        while left or any(waiting):
            if step in kinds:
                waiting, left = _changed(waiting, kinds[step], 1), left - 1
            decisions = self._decisions(waiting, busy)
            waiting, busy = min(decisions, key=lambda decision: self._cost_after(left, *decision))
            cost += self._cost_of(waiting)
            busy, step = _later(busy), step + 1
        return cost * self._queue.step_s

    def _cost(self, left: int, waiting: Waiting, busy: Busy) -> float:
        """Return the least expected cost from a step on, in which `left` requests are not made yet."""
        state = (left, waiting, busy)
        if state not in self._known:
            self._known[state] = min(
                self._cost_after(left, *decision) for decision in self._decisions(waiting, busy)
            )
        return self._known[state]

    def _cost_after(self, left: int, waiting: Waiting, busy: Busy) -> float:
        """Return the same after the decision of the step."""
        now, later = self._cost_of(waiting), _later(busy)
        if not left:
            if not now:
                return 0.0
            return float("inf") if later == busy else now + self._cost(0, waiting, later)
        made = sum(
            share * self._cost(left - 1, _changed(waiting, kind, 1), later)
            for kind, share in enumerate(self._shares)
        )
        chance = self._queue.chance
        if later == busy:
            # Nothing changes until the next request is made.
            return now / chance + made
        return now + chance * made + (1 - chance) * self._cost(left, waiting, later)

    def _decisions(self, waiting: Waiting, busy: Busy) -> Iterator[tuple[Waiting, Busy]]:
        """Yield what waits and who is busy after each decision that may be best: of a pool, the most urgent begins."""
        found, open_ = {(waiting, busy)}, [(waiting, busy)]
        while open_:
            waiting, busy = open_.pop()
            yield waiting, busy
            for begun in self._begun(waiting, busy):
                if begun not in found:
                    found.add(begun)
                    open_.append(begun)

    def _begun(self, waiting: Waiting, busy: Busy) -> Iterator[tuple[Waiting, Busy]]:
        first = {pool: kind for kind, (_, pool) in [*enumerate(self._kinds)][::-1] if waiting[kind]}
        for pool, kind in first.items():
            for user, pools in enumerate(self._queue.operators):
                if not busy[user] and pool in ("", *pools):
                    after = _changed(busy, user, self._queue.takes)
                    after = tuple(sorted(after)) if self._are_alike else after
                    yield _changed(waiting, kind, -1), after

    def _cost_of(self, waiting: Waiting) -> int:
        return sum(cost * count for cost, count in zip(self._costs, waiting, strict=True))


def _changed(counts: tuple[int, ...], place: int, by: int) -> tuple[int, ...]:
    return (*counts[:place], counts[place] + by, *counts[place + 1 :])


def _later(busy: Busy) -> Busy:
    return tuple(max(steps - 1, 0) for steps in busy)
