"""The kinds of operation that a client may send: one file a kind, and the one list of all.

An operation is a function that takes the client and the whole message; it raises a SimRobotProblem
when it cannot be done, which dispatch.py turns into a status message.
"""

from collections.abc import Callable, Mapping
from typing import Any

from sim_robot.rosbridge.client import Client
from sim_robot.rosbridge.operations import (
    advertise,
    call_service,
    publish,
    refused,
    status,
    subscribe,
)

OPERATIONS: Mapping[str, Callable[[Client, dict[str, Any]], None]] = {
    "advertise": advertise.advertise,
    "unadvertise": advertise.unadvertise,
    "publish": publish.publish,
    "subscribe": subscribe.subscribe,
    "unsubscribe": subscribe.unsubscribe,
    "call_service": call_service.call_service,
    "set_level": status.set_level,
    "status": status.status,
    **dict.fromkeys(refused.REFUSED, refused.refuse),
}
