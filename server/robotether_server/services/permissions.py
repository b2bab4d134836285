"""Whether somebody manages a robot, for what its managers may change of it."""

from robotether_server.db import Transaction, robots
from robotether_server.db.robots import SeenRobot
from robotether_server.db.users import User
from robotether_server.problems import GrantMissing, RobotUnknown


def find_managed(tx: Transaction, user: User, name: str) -> SeenRobot:
    """Return the robot if this user manages it; raise RobotUnknown when they may not see it, else GrantMissing."""
    seen = robots.find_seen(tx, user, name)
    if seen is None:
        raise RobotUnknown(f"cannot show robot {name}: there is none of that name that you may see")
    if seen.level != "manage":
        raise GrantMissing(
            f"cannot change the page of robot {name}: your grant is {seen.level}; it takes one to manage it"
        )
    return seen
