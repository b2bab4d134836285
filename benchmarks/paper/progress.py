"""How far a run is, on stderr: a bar that moves with the expected seconds on a terminal, else two lines a step."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import TextIO

from tqdm import tqdm

from paper.words import duration

BAR = "{desc} {percentage:3.0f}% |{bar}| {elapsed}, {remaining} left"
# A bar that moves more often would take time from what is measured in the same process.
REDRAW_S = 2.0
# One lock of this process is enough; tqdm would make one for several.
tqdm.set_lock(threading.RLock())
tqdm.monitor_interval = 0


class Progress:
    """Told which step begins and how it ended; a context manager, for the bar's sake."""

    def __init__(self, expected_s: float, stream: TextIO | None = None) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._expected_s, self._done_s = expected_s, 0.0
        self._bar: tqdm[None] | None = None

    def __enter__(self) -> Progress:
        if self._stream.isatty():
            self._bar = tqdm(total=self._expected_s, bar_format=BAR, file=self._stream, smoothing=0)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._bar is not None:
            self._bar.close()

    def say(self, line: str) -> None:
        """A line above the bar."""
        if self._bar is None:
            print(line, file=self._stream, flush=True)
        else:
            self._bar.write(line, file=self._stream)

    @contextmanager
    def step(self, title: str, expected_s: float) -> Iterator[None]:
        """While a step runs; counts as its expected seconds, however long it takes."""
        began = time.monotonic()
        if self._bar is None:
            left = duration(max(0.0, self._expected_s - self._done_s))
            self.say(f"{title} (some {duration(expected_s)}; all that is left, some {left})")
            yield
        else:
            self._bar.set_description_str(title, refresh=True)
            with self._moving(self._bar, began, expected_s):
                yield
        self._done_s += expected_s
        if self._bar is not None:
            self._bar.update(self._done_s - self._bar.n)

    @contextmanager
    def _moving(self, bar: tqdm[None], began: float, expected_s: float) -> Iterator[None]:
        over = threading.Event()

        def move() -> None:
            while not over.wait(REDRAW_S):
                bar.n = self._done_s + min(expected_s, time.monotonic() - began)
                bar.refresh()

        mover = threading.Thread(target=move, daemon=True, name="progress")
        mover.start()
        try:
            yield
        finally:
            over.set()
            mover.join()
