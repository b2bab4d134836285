"""Routes and web apps as they are now, and why routes ended."""

from collections.abc import Mapping
from typing import Annotated, Literal

from msgspec import Meta, Struct

from robotether_server.contract.codes import DRIVE_ENDS

RouteState = Literal["runs", "waits", "elsewhere"]


class LiveRoute(Struct, frozen=True):
    """A route that lasts.

    `runs`: `rate_hz` messages a second went to the target over the last 2 s. `waits`: nothing goes until what `why`
    says is over; a route that runs has a `why`, too, when its newest message went nowhere. `elsewhere`: if it
    runs, then on another machine of the site, which has not said so, nor its rate (null).
    """

    id: int
    state: RouteState
    rate_hz: Annotated[float, Meta(ge=0)] | None = None
    why: str = ""


class AppTopic(Struct, frozen=True):
    """A topic of an app."""

    topic: str
    type: str


class LiveApp(Struct, frozen=True):
    """A web app that is connected, with the topics that it advertises and subscribes to.

    `machine` names the machine of the site that has it; null: the one that answers.
    """

    name: str
    advertises: list[AppTopic]
    subscribes: list[AppTopic]
    machine: str | None = None


class LiveRouteList(Struct, frozen=True):
    """The routes that last and whose robots the caller may see, and the caller's apps."""

    routes: list[LiveRoute]
    apps: list[LiveApp]


# Why a route ended; a code that is not here is shown as it is.
ROUTE_ENDS: Mapping[str, str] = {
    "expired": "its time was over",
    "rights_ended": "its maker may no longer manage its robots",
    "robot_inactive": "one of its robots was disabled",
    "robot_stopped": "the target was stopped",
    "records_restored": "a backup was restored",
    "lease_held": "somebody else drove the target",
    "lease_lost": "somebody else took control of the target",
}


def end_words(code: str | None) -> str:
    """Return why a route ended, for people."""
    return ROUTE_ENDS.get(code or "", DRIVE_ENDS.get(code or "", code or ""))
