"""The control object of a robot, and the answers to stops: who drives, who asks, and who stopped the robot."""

from typing import Annotated

from msgspec import Meta, Struct

from robotether_server.schemas import RobotName

# As `times.rfc3339` writes it. A stop is named by this text, hence it is no datetime.
TimestampText = Annotated[str, Meta(extra_json_schema={"format": "date-time"})]
# A cell of a newer version may send another one.
GuardText = Annotated[str, Meta(extra_json_schema={"enum": ["down", "off", "ready", "unknown"]})]


class DriverObject(Struct, frozen=True):
    """Who drives; `fence` is the number of the lease."""

    user: str
    since: TimestampText
    fence: Annotated[int, Meta(ge=1)]


class RequestObject(Struct, frozen=True):
    """Who asks for control, and when it passes without an answer."""

    user: str
    since: TimestampText
    passes_at: TimestampText


class ReservationObject(Struct, frozen=True):
    """For whom control is reserved, and until when."""

    user: str
    until: TimestampText


class StopObject(Struct, frozen=True):
    """Who stopped the robot, and whether its guard has confirmed it."""

    by: str
    at: TimestampText
    confirmed: bool


class ControlObject(Struct, frozen=True):
    """The control object: who drives, who asks, who stopped the robot."""

    driver: DriverObject | None
    waiting: RequestObject | None
    reserved: ReservationObject | None
    stopped: StopObject | None
    guard: GuardText


NO_CONTROL = ControlObject(None, None, None, None, "unknown")


class StoppedRobot(Struct, frozen=True):
    """The result for one robot; `confirmed`: its guard has the stop."""

    name: RobotName
    stopped: bool
    confirmed: bool


class StoppedRobotList(Struct, frozen=True):
    """The result for each robot; the cells named last learn of the stops once they can be reached."""

    robots: list[StoppedRobot]
    cells_unreached: list[str]
