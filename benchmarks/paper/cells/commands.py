"""Commands that say whose they are: the name of the connection and their number travel in what nothing limits here."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

TOPIC, TYPE = "/cmd_vel", "geometry_msgs/Twist"
SPEED_M_S = 0.2


def command(connection: int, number: int) -> dict[str, Any]:
    """A rosbridge operation that moves the robot; both numbers are exact in JSON."""
    twist = {
        "linear": {"x": SPEED_M_S, "y": 0.0, "z": 0.0},
        "angular": {"x": float(number), "y": float(connection), "z": 0.0},
    }
    return {"op": "publish", "topic": TOPIC, "msg": twist}


def origin(twist: Mapping[str, Any]) -> tuple[str, int] | None:
    """Connection and number of a command; None: it is a zero."""
    if not twist["linear"]["x"]:
        return None
    return str(round(twist["angular"]["y"])), round(twist["angular"]["x"])
