"""A pacer that notes what it is asked for."""

from __future__ import annotations

from robotether_agent.video.pacer import Pacer


class NotedPacer(Pacer):
    """`turns` has the size of each turn that was requested, and whether as bulk."""

    def __init__(self) -> None:
        super().__init__()
        self.turns: list[tuple[int, bool]] = []

    async def acquire(self, requested: int, *, is_bulk: bool = False) -> int:
        self.turns.append((requested, is_bulk))
        return await super().acquire(requested, is_bulk=is_bulk)
