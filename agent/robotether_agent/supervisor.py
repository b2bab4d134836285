"""Keeps one connection going: one attempt after the other, with a pause that fits what went wrong.

Run by the agent, once for each kind of connection. Only a problem that no retry mends gets through.
"""

from __future__ import annotations

import asyncio
import logging
import time
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
    def stood_s(self) -> float:
        """Seconds since the connection stood, 0 if it never did."""
        return 0.0 if self._since is None else self._clock() - self._since


class Repeats:
    """Lets the 1st, 2nd, 4th, 8th ... of the same problem in a row into the log, not all of them."""

    def __init__(self) -> None:
        self._code = ""
        self._times = 0

    def tell(self, what: str, problem: Problem, wait_s: float) -> None:
        """Log `problem` of `what`, which is tried again after `wait_s`."""
        self._times = self._times + 1 if problem.code == self._code else 1
        self._code = problem.code
        often = "" if self._times == 1 else f" (for the {self._times}. time)"
        loud = self._times & (self._times - 1) == 0
        quiet = problem.retry is Retry.ASK_AGAIN
        level = (logging.INFO if quiet else logging.WARNING) if loud else logging.DEBUG
        log.log(level, "%s: %s; next try in %.1f s%s", what, problem, wait_s, often)

    def forget(self) -> None:
        """Start counting anew, after a success."""
        self._code = ""


async def keep_going(
    what: str,
    attempt: Callable[[Uptime], Awaitable[None]],
    backoff: Backoff,
    tell: Callable[[Problem], None],
) -> None:
    """Run `attempt` again and again; `tell` hears of each problem before the pause."""
    repeats = Repeats()
    while True:
        uptime = Uptime()
        try:
            await attempt(uptime)
        except Problem as problem:
            if uptime.stood_s:
                repeats.forget()
            wait_s = backoff.after(problem, stood_s=uptime.stood_s)
            if wait_s is None:
                raise
            tell(problem)
            repeats.tell(what, problem, wait_s)
            await asyncio.sleep(wait_s)
