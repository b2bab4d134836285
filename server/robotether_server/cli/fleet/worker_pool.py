"""Does one thing for many robots at once, so many at a time.

Its threads are daemons: one that hangs in a dead network must not hold up a person who has pressed Ctrl-C.
"""

from collections.abc import Callable, Iterator, Sequence
from queue import Empty, SimpleQueue
from threading import Thread
from time import monotonic
from typing import Generic, TypeVar

T = TypeVar("T")


class WorkerPool(Generic[T]):
    """`work` is called once for each name, and must not raise."""

    def __init__(self, work: Callable[[str], T], names: Sequence[str], parallel: int) -> None:
        self._work = work
        self._size = len(names)
        self._waiting: SimpleQueue[str] = SimpleQueue()
        self._done: SimpleQueue[T] = SimpleQueue()
        for name in names:
            self._waiting.put(name)
        self._threads = [
            Thread(target=self._work_off, daemon=True) for _ in range(min(parallel, len(names)))
        ]

    def results(self) -> Iterator[T]:
        """Start, and yield each result as it comes."""
        for thread in self._threads:
            thread.start()
        for _ in range(self._size):
            yield self._done.get()

    def stop(self, within_s: float) -> list[T]:
        """Begin nothing new; return what those at work still bring within that time."""
        end = monotonic() + within_s
        while self._next() is not None:
            pass
        for thread in self._threads:
            thread.join(max(0, end - monotonic()))
        late = []
        while not self._done.empty():
            late.append(self._done.get())
        return late

    def _work_off(self) -> None:
        while (name := self._next()) is not None:
            self._done.put(self._work(name))

    def _next(self) -> str | None:
        try:
            return self._waiting.get_nowait()
        except Empty:
            return None
