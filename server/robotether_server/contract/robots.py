"""The robot object of the event stream: a row of the database, and what the robot's cell knows of it."""

from collections.abc import Mapping
from typing import Annotated, Any

from msgspec import Meta, Struct
from robotether_common.session import Battery

from robotether_server.contract.control import NO_CONTROL, ControlObject, TimestampText

# A cell of a newer version may send other ones.
ServiceText = Annotated[str, Meta(extra_json_schema={"enum": ["down", "ok", "unknown"]})]
HelpText = Annotated[
    str, Meta(extra_json_schema={"enum": ["none", "waiting", "offered", "accepted"]})
]
StateText = Annotated[str, Meta(extra_json_schema={"enum": ["active", "disabled", "pending"]})]


class LiveState(Struct, frozen=True, kw_only=True):
    """What the cell that has a robot knows of it. Of a robot that left a cell, its report says nothing."""

    online: bool = False
    since: TimestampText | None = None
    end_code: str | None = None
    address: str | None = None
    rtt_ms: float | None = None
    ros: ServiceText = "unknown"
    video: ServiceText = "unknown"
    drivers: list[str] = []
    observers: int = 0
    agent_version: str | None = None
    battery: Battery | None = None
    control: ControlObject = NO_CONTROL
    recording: bool = False


class RobotObject(LiveState, frozen=True, kw_only=True):
    """A robot, live. Null is unknown, except where a member says otherwise.

    `since`: the last change of `online`; null: it was never seen. `end_code`: why its last session ended; null also if
    it is online. `offline_reason`: the same for people; null: it is online. `site`: null: none. `rtt_ms`: of the line
    between server and robot. `drivers`: at most one user. `observers`: other users who are connected to its rosbridge.
    `battery`: null also if it reports none. `recording`: what it sends, and what its driver does, goes into a file of
    the site. `help`: how far its request for help is, of several the farthest; none: there is none.
    """

    name: str
    mac: str
    state: StateText
    site: str | None
    offline_reason: str | None
    help: HelpText | None


class RemovedRobot(Struct, frozen=True):
    """A robot that a client may no longer see, or that has another name now."""

    name: str


# What each event of the stream carries.
EVENTS: Mapping[str, Any] = {
    "fleet": list[RobotObject],
    "robot": RobotObject,
    "removed": RemovedRobot,
}
