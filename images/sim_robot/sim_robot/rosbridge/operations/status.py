"""set_level and status: which status messages a client wants, and what it tells about itself."""

import logging
from typing import Any

from sim_robot.problems import OperationFieldInvalid
from sim_robot.rosbridge import fields
from sim_robot.rosbridge.client import STATUS_LEVELS, Client

log = logging.getLogger(__name__)


def set_level(client: Client, operation: dict[str, Any]) -> None:
    """Send only status messages of this level and above from now on."""
    level = fields.text(operation, "level")
    if level not in STATUS_LEVELS:
        raise OperationFieldInvalid(
            f"Expected field level to be one of {', '.join(STATUS_LEVELS)}, not {level!r}"
        )
    client.level = level


def status(client: Client, operation: dict[str, Any]) -> None:
    """Write what a client reports into the log."""
    log.debug("%s reports: %.200s", client.name, operation.get("msg"))
