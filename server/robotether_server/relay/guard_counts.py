"""What guards have refused since they told it last: each tells counts from its own start on.

`observers` asks at every word of a guard. Pure: no network, no clock.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable


class GuardCounts:
    """The counts that each robot's guard told last."""

    def __init__(self) -> None:
        self._reported: dict[int, dict[str, int]] = {}

    def new_refusals(self, robot_id: int, refused: Iterable[tuple[str, int]]) -> Counter[str]:
        """Return how many more it refused, by kind; nothing of a robot that is heard for the first time."""
        reported = dict(refused)
        if not reported:
            return Counter()
        # What it refused before this relay began belongs to nobody that is known.
        before = self._reported.get(robot_id, reported)
        self._reported[robot_id] = reported
        if any(reported.get(kind, 0) < count for kind, count in before.items()):
            # Another guard, which began to count anew.
            before = {}
        return +Counter({kind: count - before.get(kind, 0) for kind, count in reported.items()})

    def keep_only(self, robot_ids: Collection[int]) -> None:
        """Forget robots that are gone."""
        for robot_id in self._reported.keys() - set(robot_ids):
            del self._reported[robot_id]
