"""One live connection of a user to a robot, and the right that it needs.

The handlers of channels make one, `auth/connections` counts them. Pure.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

from robotether_server.db.fleet import RECORDER, RelayRobot, Snapshot
from robotether_server.db.grants import includes
from robotether_server.relay.http.close_reasons import CloseReason
from robotether_server.schemas import Level

Use = Literal["observe", "drive", "video"]

# Video is something to see.
NEEDED: Mapping[Use, Level] = {"observe": "observe", "drive": "drive", "video": "observe"}


@dataclass(eq=False)
class Connection:
    """One live connection of a user to a robot; it counts once it has reached the robot."""

    user_id: int
    user: str
    robot: RelayRobot
    use: Use
    end: Callable[[CloseReason], None]
    connected: bool = False
    level: Level = "observe"
    # Of a viewer: what it views, and whether it could drive.
    camera: str = ""
    may_drive: bool = False
    # Of an observer whose robot is at another cell: that cell's name.
    cell: str = ""
    # Of a user's routes: nobody is at it.
    is_route: bool = False
    # Of a request over HTTP: it has the lease for a moment.
    is_call: bool = False

    @property
    def is_recorder(self) -> bool:
        """Whether it is the stack's recorder: it takes no operator's place, and counts as none of them."""
        return self.user_id == RECORDER.id

    def user_ids(self) -> tuple[int]:
        """Return whose it is."""
        return (self.user_id,)

    def holds_in(self, snapshot: Snapshot) -> bool:
        """Return whether the user may still do this with this robot."""
        robot = snapshot.robots.get(self.robot.id)
        if robot is None or robot.state != "active" or robot.name != self.robot.name:
            return False
        level = snapshot.level(self.user_id, robot.id)
        if level is None or not permits(level, self.use) or not includes(level, self.level):
            return False
        # What it may send was fixed when it was opened.
        return self.use == "video" or _rules_of(robot) == _rules_of(self.robot)


def permits(level: Level | None, use: Use) -> bool:
    """Return whether a grant of this level is enough."""
    return level is not None and includes(level, NEEDED[use])


def _rules_of(robot: RelayRobot) -> tuple[object, ...]:
    guard = robot.settings.guard
    return robot.settings.policy, guard.drive_topics, guard.max_age_ms
