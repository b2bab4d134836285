"""Asyncio work in a thread of its own, beside a test or an experiment that is synchronous."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from typing import Self

BEGINS_WITHIN_S = 10.0


class LoopThread:
    """Runs `_work` as long as the `with` block, which begins when `_begun` is set; it may end by `endings`."""

    endings: tuple[type[Exception], ...] = ()

    def __init__(self, what: str) -> None:
        self._what = what
        self._begun = threading.Event()
        self._loop = asyncio.new_event_loop()
        self._task: asyncio.Task[None] | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        assert self._begun.wait(BEGINS_WITHIN_S), f"no {self._what} in {BEGINS_WITHIN_S:g} s"
        return self

    def __exit__(self, *_: object) -> None:
        if self._task is not None and self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._task.cancel)
        self._thread.join(10)
        self._loop.close()

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._task = self._loop.create_task(self._work())
        with contextlib.suppress(asyncio.CancelledError, *self.endings):
            self._loop.run_until_complete(self._task)

    async def _work(self) -> None:
        raise NotImplementedError
