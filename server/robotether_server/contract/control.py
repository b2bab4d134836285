"""The control object of a robot, the requests that change it, and the answers to stops.

The relay reads and answers these; `api.relayed` describes them.
"""

from typing import Annotated, Literal

from msgspec import UNSET, Meta, Struct, UnsetType

from robotether_server.identity import normalise_mac
from robotether_server.problems import RobotetherError
from robotether_server.schemas import Mac, PlainName, RobotName, UserName

MAX_REASON = 255
MAX_PRESS = 64
# Maximum length of what names a stop to release, or a driver. It is compared as it is, and never shown.
MAX_SHOWN = 255

# As `times.rfc3339` writes it. A stop is named by this text, hence it is no datetime.
TimestampText = Annotated[str, Meta(extra_json_schema={"format": "date-time"})]
# A cell of a newer version may send another one.
GuardText = Annotated[str, Meta(extra_json_schema={"enum": ["down", "off", "ready", "unknown"]})]
AS_SHOWN = Meta(
    extra={
        "as_typed": True,
        "longest": MAX_SHOWN,
        "must": "a text; give by and at, as the control object shows them",
    }
)


SHOWN_DRIVER = Meta(
    extra={
        "as_typed": True,
        "longest": MAX_SHOWN,
        "must": "a text; give the driver's user, as the control object shows it",
    }
)


def _reason(value: object, _path: str) -> str | None:
    """Return a text for people, which may be empty, cut and in one line: no stop fails for its reason."""
    if not isinstance(value, str):
        return None
    return "".join(each if each.isprintable() else " " for each in value[:MAX_REASON])


Reason = Annotated[str, Meta(extra={"read": _reason})]


class DriverObject(Struct, frozen=True):
    """Who drives; `fence` is the number of the lease. `NAME (route)`: routes of that user."""

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


class ShownStop(Struct, frozen=True, forbid_unknown_fields=True):
    """The stop that is meant, as the control object shows it, which is all that a person knows of it."""

    by: Annotated[str, AS_SHOWN]
    at: Annotated[TimestampText, AS_SHOWN]


class StopReason(Struct, frozen=True, forbid_unknown_fields=True):
    """A reason for people to read."""

    reason: Reason | None = None


MeantMac = Annotated[
    Mac,
    Meta(
        description="Of the robot that is meant: 404 if another one has the name now; a stop goes to it all the same"
    ),
]


class RobotQuery(Struct, frozen=True, forbid_unknown_fields=True):
    """Which robot is meant, beside the name in the path."""

    mac: MeantMac | UnsetType = UNSET


class StopQuery(RobotQuery, frozen=True):
    """Which press it is, by any text: one that the server has had in another way is no other stop."""

    press: Annotated[str, Meta(max_length=MAX_PRESS)] | UnsetType = UNSET


def press_of(value: object) -> str | None:
    """Return the id of a press; None for what is none, which refuses no stop."""
    return value if isinstance(value, str) and len(value) <= MAX_PRESS else None


def mac_of(value: object) -> str | None:
    """Return the MAC of the robot that is meant; None for what is none, which refuses no stop."""
    try:
        return normalise_mac(value) if isinstance(value, str) else None
    except RobotetherError:
        return None


class SiteStop(StopReason, frozen=True, forbid_unknown_fields=True):
    """The site, if not all, and the reason."""

    site: PlainName | None = None


class LeaseAction(Struct, frozen=True, forbid_unknown_fields=True):
    """An action on the lease.

    `to`, with hand_over: who must be asking, else 409 nobody_asks. `driver`, with take: who must be driving, else
    409 not_possible.
    """

    action: Literal["ask", "withdraw", "hand_over", "refuse", "take"]
    to: UserName | UnsetType = UNSET
    driver: Annotated[str, SHOWN_DRIVER] | UnsetType = UNSET


class ControlObject(Struct, frozen=True):
    """The control object: who drives, who asks, who stopped the robot.

    `blind_limits`: whether its guard has the limits `blind_m` and `blind_deg` (older ones ignore them); null: unknown.
    """

    driver: DriverObject | None
    waiting: RequestObject | None
    reserved: ReservationObject | None
    stopped: StopObject | None
    guard: GuardText
    blind_limits: bool | None = None


NO_CONTROL = ControlObject(None, None, None, None, "unknown")


class StoppedRobot(Struct, frozen=True):
    """The result for one robot; `confirmed`: its guard has the stop."""

    name: RobotName
    mac: Mac
    stopped: bool
    confirmed: bool


class StoppedRobotList(Struct, frozen=True):
    """The result for each robot; the cells named last learn of the stops once they can be reached."""

    robots: list[StoppedRobot]
    cells_unreached: list[str]
