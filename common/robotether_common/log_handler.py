"""Writes the log to standard error without waiting for whoever reads it."""

from __future__ import annotations

import logging
import os
import select
from contextlib import suppress

STDERR = 2


class LogHandler(logging.Handler):
    """Writes to stderr what need not wait: a journal or log driver that hangs must hold up no stop."""

    def __init__(self) -> None:
        super().__init__()
        self._lost = 0
        self._ready = select.poll()
        self._ready.register(STDERR, select.POLLOUT)

    def emit(self, record: logging.LogRecord) -> None:
        """Write a record, or count that it is lost."""
        try:
            text = self.format(record) + "\n"
        except Exception:  # noqa: BLE001  # as logging's own handlers: a wrong log line ends nothing
            self.handleError(record)
            return
        if self._lost:
            text = f"the log was full: {self._lost} messages are lost\n{text}"
        data = text.encode(errors="backslashreplace")
        for start in range(0, len(data), select.PIPE_BUF):
            if not self._ready.poll(0):
                self._lost += 1
                return
            # Where nobody reads it any more there is nobody to tell.
            with suppress(OSError):
                os.write(STDERR, data[start : start + select.PIPE_BUF])
        self._lost = 0
