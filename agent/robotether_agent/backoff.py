"""Decides when to retry: the delays, retry or give up, and the loop that follows both.

`keep_going` is run by the daemon, once for each kind of connection. Only a problem that no retry mends gets through.
"""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Iterator
from random import Random

from robotether_agent.files import MACHINE_FAULTS
from robotether_agent.problems import (
    AgentError,
    NetworkChangedError,
    Retry,
    ServerBusyError,
    ServerSilentError,
    SessionEndedError,
)

MIN_DELAY_S = 0.5
MAX_DELAY_S = 15.0
# Pause after an attempt that itself waited for an answer, or while the server is known to answer.
AT_ONCE_S = (0.02, 0.2)
# Pause after silence on an open connection: of the network, or of this machine, which was suspended. If
# the server was silent, its whole fleet returns at once; this spreads it, after the robots in use.
AFTER_SILENCE_S = (0.2, 0.7)
# Pause of a robot that was in use, and maximum number of such attempts in a row: together longer than a
# server's restart.
USED_S, USED_TRIES = (0.1, 0.6), 30
# Maximum pause after a busy server rejected a log-in: it has room as soon as another one ends, and
# a rejection costs it almost nothing.
MAX_BUSY_S = 4.0
ASK_AGAIN_S = (5.0, 15.0)
SLOWLY_S = (15.0, 30.0)
# Pause of an agent that fails at its start, below WatchdogSec: systemd restarts it a second after
# its end.
FAILED_START_S = (5.0, 15.0)
# Time after which a connection counts as stable: its end is then a new problem.
STABLE_S = 10.0
# First maximum of the pause after a connection that was not stable.
AFTER_SHORT_S = 2.0

log = logging.getLogger(__name__)


def delays(rng: Random, ceiling: float = 2 * MIN_DELAY_S) -> Iterator[float]:
    """Yield seconds without end: each drawn from 0.5 s up to a ceiling that doubles from 1 s to 15 s.

    The full jitter spreads a fleet that lost its server at the same time.
    """
    while True:
        yield rng.uniform(MIN_DELAY_S, ceiling)
        ceiling = min(MAX_DELAY_S, 2 * ceiling)


def retry_or_give_up(problem: AgentError, soon: Iterator[float], rng: Random) -> float | None:
    """Return the seconds to wait before the next try after `problem`, or None to give up."""
    if problem.retry is Retry.NEVER:
        return None
    if problem.retry is Retry.AT_ONCE:
        return rng.uniform(*AT_ONCE_S)
    if problem.retry is Retry.ASK_AGAIN:
        return rng.uniform(*ASK_AGAIN_S)
    if problem.retry is Retry.SLOWLY:
        return rng.uniform(*SLOWLY_S)
    if isinstance(problem, ServerBusyError):
        return min(next(soon), rng.uniform(MIN_DELAY_S, MAX_BUSY_S))
    return next(soon)


def before_restart(ran_s: float, rng: Random) -> float:
    """Return the seconds that an agent waits before it ends with an error, after it ran for `ran_s`.

    An agent that ran well is back at once; one that fails at each start leaves the robot's processor alone.
    """
    return 0.0 if ran_s >= STABLE_S else rng.uniform(*FAILED_START_S)


class Backoff:
    """The delays of one connection, which start again after it was up for a while."""

    def __init__(self, rng: Random) -> None:
        self._rng = rng
        self._soon = delays(rng)
        # How often it is still tried before the others.
        self._first_tries = 0

    def after(
        self, problem: AgentError, *, uptime_s: float, was_used: bool = False
    ) -> float | None:
        """Return the seconds to wait after `problem` ended a connection that was up for `uptime_s`.

        A robot that somebody used, as few of a fleet are, goes before the others until it has a connection again.
        """
        is_soon = problem.retry is Retry.SOON
        if uptime_s >= STABLE_S:
            self._soon = delays(self._rng)
            self._first_tries = USED_TRIES if was_used else 0
            if was_used and is_soon:
                return self._rng.uniform(*AT_ONCE_S)
            if isinstance(problem, ServerSilentError) and is_soon:
                return self._rng.uniform(*AFTER_SILENCE_S)
            if isinstance(problem, NetworkChangedError):
                # It is this robot's own network, and no fleet's.
                return 0.0
        elif isinstance(problem, SessionEndedError) and problem.retry is Retry.AT_ONCE:
            # A cell that sends the robot away as soon as it is there has no other one to name.
            return next(self._soon)
        elif uptime_s:
            # It came up, so that what failed before is over.
            self._soon = delays(self._rng, ceiling=AFTER_SHORT_S)
        if is_soon and self._first_tries:
            self._first_tries -= 1
            return self._rng.uniform(*USED_S)
        return retry_or_give_up(problem, self._soon, self._rng)


class Uptime:
    """How long the present attempt has been up, and whether somebody used the robot at its end."""

    def __init__(self) -> None:
        self._since: float | None = None
        self.was_used = False

    def is_up(self) -> None:
        """Note that the connection is up."""
        if self._since is None:
            self._since = time.monotonic()

    @property
    def uptime_s(self) -> float:
        """Seconds since the connection came up, 0 if it never did."""
        return 0.0 if self._since is None else time.monotonic() - self._since


class Repeats:
    """Lets the 1st, 2nd, 4th, 8th ... of the same problem into the log, until it is forgotten.

    A server that is down for days then leaves some lines a day and not one every second, also when two
    problems take turns.
    """

    def __init__(self) -> None:
        self._times: Counter[str] = Counter()

    def log_problem(self, what: str, problem: AgentError, wait_s: float | None = None) -> None:
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
        """Start counting again, after a success."""
        self._times.clear()


async def keep_going(
    what: str,
    attempt: Callable[[Uptime], Awaitable[None]],
    backoff: Backoff,
    on_problem: Callable[[AgentError], None],
    pause: Callable[[float], Awaitable[None]],
) -> None:
    """Run `attempt` again and again; `on_problem` gets each problem before the pause."""
    repeats = Repeats()
    while True:
        uptime = Uptime()
        try:
            await attempt(uptime)
        except (AgentError, OSError) as error:
            problem = _problem_of(error)
            if uptime.uptime_s:
                repeats.forget()
            wait_s = backoff.after(problem, uptime_s=uptime.uptime_s, was_used=uptime.was_used)
            if wait_s is None:
                raise
            on_problem(problem)
            repeats.log_problem(what, problem, wait_s)
            await pause(wait_s)


def _problem_of(error: AgentError | OSError) -> AgentError:
    """Return what ended an attempt; raise what is no passing fault of this machine, but a defect."""
    if isinstance(error, AgentError):
        return error
    fault = MACHINE_FAULTS.get(error.errno or 0)
    if fault is None:
        raise error
    why, advice = fault
    return AgentError(f"cannot go on: {why}", advice=advice)
