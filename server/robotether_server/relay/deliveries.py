"""How many pictures each user got of each robot, and how many bytes they had: for the records of drives.

`feeds` and `video` count, `reports` reads at a drive's beginning and end. Numbers only grow while the relay
runs. Pure: no clock, no network.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Delivered:
    """Pictures, and the bytes of these pictures."""

    pictures: int = 0
    bytes: int = 0

    def since(self, earlier: Delivered) -> Delivered:
        """Return what came after `earlier`, which is an older count of the same."""
        return Delivered(self.pictures - earlier.pictures, self.bytes - earlier.bytes)


NOTHING = Delivered()


class Deliveries:
    """The counts, by robot and user."""

    def __init__(self) -> None:
        self._counts: dict[tuple[int, int], Delivered] = {}

    def count(self, robot_id: int, user_id: int, size: int) -> None:
        """A picture of `size` bytes went to this user."""
        before = self.of(robot_id, user_id)
        self._counts[robot_id, user_id] = Delivered(before.pictures + 1, before.bytes + size)

    def of(self, robot_id: int, user_id: int) -> Delivered:
        """Return what this user got of this robot since the relay's start."""
        return self._counts.get((robot_id, user_id), NOTHING)
