"""Operations that the real rosbridge knows and the simulated robot does not offer.

They are refused by name, so that nobody waits for an answer that does not come.
"""

from typing import Any

from sim_robot.problems import OperationRefused
from sim_robot.rosbridge.client import Client

REFUSED = (
    "advertise_service",
    "unadvertise_service",
    "service_response",
    "advertise_action",
    "unadvertise_action",
    "send_action_goal",
    "cancel_action_goal",
    "action_feedback",
    "action_result",
    "fragment",
    "png",
    "auth",
)


def refuse(_client: Client, operation: dict[str, Any]) -> None:
    """Say that this is not offered."""
    raise OperationRefused(f"the simulated robot does not offer the operation {operation['op']}")
