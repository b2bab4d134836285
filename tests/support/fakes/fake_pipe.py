"""The pipe to the agent, for tests of what a guard says on it."""

from __future__ import annotations

import asyncio
import json
from typing import Any


class FakePipe(asyncio.WriteTransport):
    """Keeps what is written; `waiting` is what the agent has not read."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[dict[str, Any]] = []
        self.waiting = 0

    def write(self, data: Any) -> None:
        self.lines.append(json.loads(data))

    def is_closing(self) -> bool:
        return False

    def get_write_buffer_size(self) -> int:
        return self.waiting
