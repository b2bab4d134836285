"""What guards have refused since they told it last: each tells counts from its own start on.

`reports` asks at every word of a guard. Pure: no network, no clock.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable


class GuardCounts:
    """The counts that each robot's guard told last."""

    def __init__(self) -> None:
        self._told: dict[int, dict[str, int]] = {}

    def news(self, robot_id: int, refused: Iterable[tuple[str, int]]) -> Counter[str]:
        """Return how many more it refused, by kind; nothing of a robot that is heard for the first time."""
        told = dict(refused)
        if not told:
            return Counter()
        # What it refused before this relay began belongs to nobody that is known.
        before = self._told.get(robot_id, told)
        self._told[robot_id] = told
        if any(told.get(kind, 0) < count for kind, count in before.items()):
            # Another guard, which began to count anew.
            before = {}
        return +Counter({kind: count - before.get(kind, 0) for kind, count in told.items()})

    def keep_only(self, robot_ids: Collection[int]) -> None:
        """Forget robots that are gone."""
        for robot_id in self._told.keys() - set(robot_ids):
            del self._told[robot_id]
