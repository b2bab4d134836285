"""What the relay answers under /api/v1 (relay/control/control_api.py, relay/events): nginx leads it there.

Described here, as one API has one description; nothing of it is handled here.
"""

from typing import Annotated, Any, Literal

from msgspec import UNSET, Meta, Struct, UnsetType

from robotether_server.api.operations import ApiOperation
from robotether_server.schemas import PlainName, RobotName, Timestamp


class ShownDriver(Struct):
    """Who drives; `fence` is the number of the lease."""

    user: str
    since: Timestamp
    fence: Annotated[int, Meta(ge=1)]


class ShownWaiting(Struct):
    """Who asks for the control, and when it passes by itself."""

    user: str
    since: Timestamp
    passes_at: Timestamp


class ShownReservation(Struct):
    """For whom the control is kept, and until when."""

    user: str
    until: Timestamp


class ConfirmedStop(Struct):
    """Who stopped the robot, and whether its guard has it."""

    by: str
    at: Timestamp
    confirmed: bool


class ShownControl(Struct):
    """Who drives, who waits and whether it is stopped."""

    driver: ShownDriver | None
    waiting: ShownWaiting | None
    reserved: ShownReservation | None
    stopped: ConfirmedStop | None
    guard: Literal["ready", "down", "off", "unknown"]


class LeaseAction(Struct):
    """What to do; `to`, with hand_over: who must be asking, else 409 nobody_asks."""

    action: Literal["ask", "withdraw", "hand_over", "refuse", "take"]
    to: str | UnsetType = UNSET


class StopReason(Struct):
    """Why, if it is to be told."""

    reason: Annotated[str, Meta(max_length=255)] | UnsetType = UNSET


class ReleasedStop(Struct):
    """Which stop, as the control object shows it."""

    by: str | UnsetType = UNSET
    at: Timestamp | UnsetType = UNSET


class StoppedSite(Struct):
    """Where, if not everywhere."""

    site: PlainName | UnsetType = UNSET


class StoppedRobot(Struct):
    """What became of a robot; `confirmed`: its guard has it."""

    name: RobotName
    stopped: bool
    confirmed: bool


class StoppedRobotList(Struct):
    """What became of each."""

    robots: list[StoppedRobot]


BOTH_OR_NEITHER = Meta(extra_json_schema={"dependentRequired": {"by": ["at"], "at": ["by"]}})
CONTROL: dict[int, Any] = {200: ShownControl}

RELAYED = (
    ApiOperation(
        method="GET",
        path="/events",
        name="events",
        summary="The fleet, live",
        details="Server-sent events fleet, robot and removed; it does not end.",
        who="user",
        answers={200: None},
        texts=("text/event-stream",),
        problems=(429,),
    ),
    ApiOperation(
        method="GET",
        path="/robots/<robot>/control",
        name="showControl",
        summary="Who drives, who waits and whether it is stopped",
        who="user",
        tag="control",
        answers=CONTROL,
    ),
    ApiOperation(
        method="POST",
        path="/robots/<robot>/lease",
        name="changeLease",
        summary="Ask for the control, answer who asks, or take it",
        details="ask and withdraw: whoever may drive; 429 throttled after three questions in a row, with Retry-After. "
        "hand_over and refuse: the driver. take: whoever manages the robot.",
        who="user",
        tag="control",
        body=LeaseAction,
        answers=CONTROL,
        problems=(409, 429),
    ),
    ApiOperation(
        method="POST",
        path="/robots/<robot>/stop",
        name="stopRobot",
        summary="Stop the robot; whoever may see it",
        details="Ends the control, and takes the place of somebody else's stop; the robot stays stopped until a driver "
        "releases it. No safety-rated emergency stop.",
        who="user",
        tag="control",
        body=StopReason,
        is_body_required=False,
        answers=CONTROL,
    ),
    ApiOperation(
        method="POST",
        path="/robots/<robot>/release",
        name="releaseRobot",
        summary="Let a stopped robot be driven again; whoever may drive it",
        details="With by and at, as the control object shows them, only that stop; 409 not_possible says whose stop it "
        "is by then.",
        who="user",
        tag="control",
        body=Annotated[ReleasedStop, BOTH_OR_NEITHER],
        is_body_required=False,
        answers=CONTROL,
        problems=(409, 504),
    ),
    ApiOperation(
        method="POST",
        path="/stop",
        name="stopAll",
        summary="Stop all robots, or those of a site, that the caller manages",
        who="user",
        tag="control",
        body=StoppedSite,
        is_body_required=False,
        answers={200: StoppedRobotList},
    ),
)
