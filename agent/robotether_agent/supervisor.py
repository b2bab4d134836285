"""Keeps one connection going: one attempt after the other, with a pause that fits what went wrong.

Run by the agent, once for each kind of connection. Only a problem that no retry mends gets through.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections import Counter
from collections.abc import Awaitable, Callable

from robotether_agent.backoff import Backoff
from robotether_agent.problems import Problem, Retry

log = logging.getLogger(__name__)


class Uptime:
    """How long the present attempt has stood."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._since: float | None = None

    def is_up(self) -> None:
        """Note that the connection stands."""
        if self._since is None:
            self._since = self._clock()

    @property
    def uptime_s(self) -> float:
        """Seconds since the connection stood, 0 if it never did."""
        return 0.0 if self._since is None else self._clock() - self._since


class Repeats:
    """Lets the 1st, 2nd, 4th, 8th ... of the same problem into the log, until it is forgotten.

    A server that is down for days then leaves some lines a day and not one every second, also when two
    problems take turns.
    """

    def __init__(self) -> None:
        self._times: Counter[str] = Counter()

    def log_problem(self, what: str, problem: Problem, wait_s: float | None = None) -> None:
        """Log `problem` of `what`, which is tried again after `wait_s`, if that is known."""
        self._times[problem.code] += 1
        times = self._times[problem.code]
        loud = times & (times - 1) == 0
        quiet = problem.retry is Retry.ASK_AGAIN
        level = (logging.INFO if quiet else logging.WARNING) if loud else logging.DEBUG
        again = "" if wait_s is None else f"; next try in {wait_s:.1f} s"
        often = "" if times == 1 else f" (for the {times}. time)"
        log.log(level, "%s: %s%s%s", what, problem, again, often)

    def forget(self) -> None:
        """Start counting anew, after a success."""
        self._times.clear()


async def keep_going(
    what: str,
    attempt: Callable[[Uptime], Awaitable[None]],
    backoff: Backoff,
    on_problem: Callable[[Problem], None],
    pause: Callable[[float], Awaitable[None]] = asyncio.sleep,
) -> None:
    """Run `attempt` again and again; `on_problem` gets each problem before the pause."""
    repeats = Repeats()
    while True:
        uptime = Uptime()
        try:
            await attempt(uptime)
        except Problem as problem:
            if uptime.uptime_s:
                repeats.forget()
            wait_s = backoff.after(problem, uptime_s=uptime.uptime_s)
            if wait_s is None:
                raise
            on_problem(problem)
            repeats.log_problem(what, problem, wait_s)
            await pause(wait_s)
