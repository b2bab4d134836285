"""The robot object of the event stream: a row of the database, and what the robot's cell knows of it."""

from msgspec import Struct
from robotether_common.session import Battery

from robotether_server.contract.control import NO_CONTROL, ControlObject, TimestampText


class LiveState(Struct, frozen=True, kw_only=True):
    """What the cell that has a robot knows of it.

    `since`: the last change of `online`; None: it was never seen. `end_code`: why its last session ended; None:
    unknown. `ros`, `video`: ok, down or unknown. Of a robot that left a cell, its report says nothing.
    """

    online: bool = False
    since: TimestampText | None = None
    end_code: str | None = None
    address: str | None = None
    rtt_ms: float | None = None
    ros: str = "unknown"
    video: str = "unknown"
    drivers: list[str] = []
    observers: int = 0
    agent_version: str | None = None
    battery: Battery | None = None
    control: ControlObject = NO_CONTROL


class RobotObject(LiveState, frozen=True, kw_only=True):
    """A robot as the clients of the event stream get it; `offline_reason` None: it is online."""

    name: str
    state: str
    site: str | None
    offline_reason: str | None


class RemovedRobot(Struct, frozen=True):
    """A robot that a client may no longer see, or that has another name now."""

    name: str
