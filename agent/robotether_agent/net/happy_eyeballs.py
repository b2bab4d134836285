"""Starts several attempts, each a little after the one before, and takes the first that succeeds (RFC 8305).

Used for addresses, for ports, and for trying again while nothing answers. What comes in too late is dropped. In place
of aiohappyeyeballs, which knows addresses only, and says of several that failed neither which one refused nor why.
"""

from __future__ import annotations

import asyncio
import re
from collections import deque
from collections.abc import Awaitable, Callable, Iterable, Iterator, Sequence
from itertools import takewhile
from typing import Generic, TypeVar

from robotether_agent.problems import (
    AgentError,
    NoAnswerError,
    ServerBusyError,
    ServerUnreachableError,
)

T = TypeVar("T")
Pause = Callable[[], Awaitable[None]]
# Maximum number of problems that are reported, the last ones.
MAX_PROBLEMS = 8
WHERE = re.compile(r"(.*) \(([^()]*)\)")


def after(seconds: float) -> Pause:
    """Return a pause of always the same length."""
    return lambda: asyncio.sleep(seconds)


class HappyEyeballs(Generic[T]):
    """Attempts of which one wins; `pause` is between two starts, and `drop` gets what came in too late.

    The next attempt starts also when one has failed, if `eager`. Else they go on until something answers: that is for
    attempts without end, and a refusal ends them. Problems of the kinds `ends` end all attempts at once: usually that
    the server is busy, whose other ports and addresses would only give it more to do.
    """

    def __init__(
        self,
        attempts: Iterable[Callable[[], Awaitable[T]]],
        *,
        pause: Pause,
        drop: Callable[[T], None],
        eager: bool = True,
        ends: tuple[type[AgentError], ...] | None = None,
    ) -> None:
        # A race of one costs more than the attempt.
        self._only = attempts[0] if isinstance(attempts, list) and len(attempts) == 1 else None
        self._waiting: Iterator[Callable[[], Awaitable[T]]] = iter(attempts)
        self._pause = pause
        self._drop = drop
        self._eager = eager
        self._ends = (
            ends if ends is not None else (ServerBusyError if eager else ServerUnreachableError,)
        )
        self._running: list[asyncio.Future[T]] = []
        self._pausing: asyncio.Future[None] | None = None
        self._failed: deque[AgentError] = deque(maxlen=MAX_PROBLEMS)

    @property
    def problem(self) -> AgentError:
        """What the attempts said so far, as one."""
        return combined_problem(self._failed)

    async def winner(self) -> T:
        """Return what the first attempt that works returns; raise `problem` when all have failed."""
        if self._only is not None:
            return await self._run(self._only)
        won = None
        try:
            self._start_next()
            while won is None and (self._running or self._pausing):
                await self._something()
                won = self._won()
            if won is None:
                raise self.problem
        finally:
            await self._end(won)
        return won.result()

    def _start_next(self) -> None:
        if self._pausing is not None:
            self._pausing.cancel()
            self._pausing = None
        attempt = next(self._waiting, None)
        if attempt is not None:
            self._running.append(asyncio.ensure_future(self._run(attempt)))
            self._pausing = asyncio.ensure_future(self._pause())

    async def _run(self, attempt: Callable[[], Awaitable[T]]) -> T:
        """Return what the attempt returns; drop it when a cancellation came with it (`within`), which would lose it."""
        result = await attempt()
        try:
            await asyncio.sleep(0)
        except asyncio.CancelledError:
            self._drop(result)
            raise
        return result

    async def _something(self) -> None:
        awaited: list[asyncio.Future[T] | asyncio.Future[None]] = [*self._running]
        if self._pausing is not None:
            awaited.append(self._pausing)
        await asyncio.wait(awaited, return_when=asyncio.FIRST_COMPLETED)

    def _won(self) -> asyncio.Future[T] | None:
        """Return an attempt that worked; put away those that failed, and start the next when it is time."""
        is_time = self._pausing is not None and self._pausing.done()
        for attempt in [item for item in self._running if item.done()]:
            error = attempt.exception()
            if error is None:
                return attempt
            self._running.remove(attempt)
            if not isinstance(error, AgentError):
                raise error
            self._failed.append(error)
            if isinstance(error, self._ends):
                raise error
            is_time = is_time or self._eager
        if is_time:
            self._start_next()
        return None

    async def _end(self, won: asyncio.Future[T] | None) -> None:
        """End all other attempts; whoever is cancelled meanwhile will not take what the first one brought either."""
        late = [attempt for attempt in self._running if attempt is not won]
        left: list[asyncio.Future[T] | asyncio.Future[None]] = [*late]
        if self._pausing is not None:
            left.append(self._pausing)
        for item in left:
            item.cancel()
        try:
            if left:
                await asyncio.wait(left)
        except asyncio.CancelledError:
            late = self._running
            raise
        finally:
            for attempt in late:
                if attempt.done():
                    self._drop_late(attempt)
                else:
                    attempt.add_done_callback(self._drop_late)

    def _drop_late(self, attempt: asyncio.Future[T]) -> None:
        if not attempt.cancelled() and attempt.exception() is None:
            self._drop(attempt.result())


def combined_problem(failed: Sequence[AgentError]) -> AgentError:
    """Return one problem for all: that nothing answered only if really nothing did; a server's own word counts most."""
    for kind in (ServerBusyError, ServerUnreachableError):
        problems = [problem for problem in failed if isinstance(problem, kind)]
        if problems:
            return _merged(kind, problems)
    return _merged(NoAnswerError, failed)


def _merged(kind: type[AgentError], problems: Sequence[AgentError]) -> AgentError:
    message = said_once(problem.message for problem in problems)
    advice = next((problem.advice for problem in problems if problem.advice), None)
    return kind(message or "cannot connect: nothing answers", advice=advice)


def said_once(messages: Iterable[str]) -> str:
    """Return sentences "cannot DO WHAT: WHY (WHERE)" as one, in which no reason stands twice."""
    wheres: dict[tuple[str, str], list[str]] = {}
    for message in dict.fromkeys(messages):
        what, colon, why = message.partition(": ")
        what, why = (what, why) if colon else ("", what)
        match = WHERE.fullmatch(why)
        why, where = match.groups() if match else (why, "")
        wheres.setdefault((what, why), []).append(where)
    whats: dict[str, list[str]] = {}
    for (what, why), places in wheres.items():
        where = ", ".join(dict.fromkeys(filter(None, places)))
        whats.setdefault(f"{why} ({where})" if where else why, []).append(what)
    whys: dict[str, list[str]] = {}
    for why, named in whats.items():
        whys.setdefault(_listed(named), []).append(why)
    return "; ".join(
        f"{what}: {'; '.join(reasons)}" if what else "; ".join(reasons)
        for what, reasons in whys.items()
    )


def _listed(names: Sequence[str]) -> str:
    """Return several names as one list, with the words that they begin with once."""
    words = [name.split(" ") for name in names]
    columns = takewhile(lambda column: len(set(column)) == 1, zip(*words, strict=False))
    shared = len(list(columns))
    return ", ".join([names[0], *(" ".join(parts[shared:]) for parts in words[1:])])
