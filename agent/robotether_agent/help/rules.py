"""The rules by which a robot asks for help, each on its edge. Pure: no clock, no topics.

A rule asks when it becomes true, and again only after it was clear for CLEAR_AFTER_S. What is unknown neither asks nor
clears. Between the two values of a threshold nothing changes, so that noise does not ask.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from robotether_common.ros import octet_of
from robotether_common.session import (
    LOWEST_PRIORITY,
    MAX_HELP_REASON,
    Battery,
    HelpCall,
    HelpSource,
)

from robotether_agent.fields import (
    TOPIC,
    FieldError,
    JsonObject,
    as_object,
    get_flag,
    get_match,
    get_number,
    get_optional_number,
    number_in,
    parse_object,
    printable,
)

# Time for which a rule must be clear before it asks again.
CLEAR_AFTER_S = 10.0
# Margin above its threshold, in percent, at which a low battery is clear.
BATTERY_CLEAR_PERCENT = 5
# Margin inside the geofence at which leaving it is clear.
FENCE_CLEAR_M = 0.5
# Number of corners of a geofence, and maximum of a coordinate.
MIN_CORNERS, MAX_CORNERS, MAX_COORDINATE_M = 3, 32, 1e7
# Maximum number of components whose diagnostics are remembered: the newest, as names may change without end.
MAX_COMPONENTS = 500
# Time without a word after which a component counts as gone, as on the drive page.
COMPONENT_SILENT_S = 10.0
ERROR = 2  # of a diagnostic_msgs/DiagnosticStatus

Point = tuple[float, float]


@dataclass(frozen=True)
class HelpConfig:
    """What the robot's settings say of asking for help; None and False are off.

    The topics of diagnostics and pose are found by their types if they have no name.
    """

    topic: str | None = None
    stopped: bool = False
    battery_below: float | None = None
    diagnostics: bool = False
    diagnostics_topic: str | None = None
    geofence: tuple[Point, ...] = ()
    pose_topic: str | None = None
    navigation_topic: str | None = None
    navigation_silent_s: float | None = None


def help_config(members: JsonObject) -> HelpConfig:
    """Return what the server's configuration says; FieldError for what cannot be meant."""
    return HelpConfig(
        topic=_topic(members, "topic"),
        stopped=get_flag(members, "stopped", default=False),
        battery_below=get_optional_number(members, "battery_below", 1, 100),
        diagnostics=get_flag(members, "diagnostics", default=False),
        diagnostics_topic=_topic(members, "diagnostics_topic"),
        geofence=_corners(members.get("geofence")),
        pose_topic=_topic(members, "pose_topic"),
        navigation_topic=_topic(members, "navigation_topic"),
        navigation_silent_s=get_optional_number(members, "navigation_silent_s", 0.1, 86_400),
    )


def _topic(members: JsonObject, name: str) -> str | None:
    is_missing = members.get(name) is None
    return None if is_missing else get_match(members, name, TOPIC, "a topic's full name")


def _corners(value: object) -> tuple[Point, ...]:
    if value is None:
        return ()
    if not isinstance(value, list) or not MIN_CORNERS <= len(value) <= MAX_CORNERS:
        raise FieldError(f"field geofence must be {MIN_CORNERS} to {MAX_CORNERS} points")
    return tuple(_corner(corner) for corner in value)


def _corner(value: object) -> Point:
    if not isinstance(value, list) or len(value) != 2:  # noqa: PLR2004 - x and y
        raise FieldError("field geofence must have points of x and y")
    point = dict(zip("xy", value, strict=True))
    x, y = (get_number(point, axis, -MAX_COORDINATE_M, MAX_COORDINATE_M) for axis in "xy")
    return x, y


class Edge:
    """Notices that something becomes true, and again only after it was clear for a while."""

    def __init__(self) -> None:
        self._is_raised = False
        self._clear_since_s: float | None = None

    def update(self, state: bool | None, now_s: float) -> bool:
        """Return whether this is the edge; None is unknown, or between clear and true."""
        since_s = self._clear_since_s
        if since_s is not None and now_s - since_s >= CLEAR_AFTER_S:
            self._is_raised = False
        if state is False:
            self._clear_since_s = now_s if since_s is None else since_s
            return False
        self._clear_since_s = None
        is_edge = state is True and not self._is_raised
        self._is_raised = self._is_raised or is_edge
        return is_edge


class HelpRules:
    """All rules of one configuration; each method returns the call for help that a reading leads to, if any."""

    def __init__(self, config: HelpConfig) -> None:
        self._config = config
        self._edges: dict[HelpSource, Edge] = {}
        # Whether each failed, in which words, and when it last said so; the newest is the last.
        self._components: dict[str, tuple[bool, str, float]] = {}
        self._silent_since_s: float | None = None

    def on_stopped(self, stopped: bool | None, by: str, now_s: float) -> HelpCall | None:
        """The guard's stop is set or not; None: the guard does not say."""
        return self._call("stop", stopped, now_s, lambda: f"stopped by {by or 'somebody'}")

    def on_battery(self, battery: Battery | None, now_s: float) -> HelpCall | None:
        """The battery is as full as this; None: unknown. One that is charged asks for nobody."""
        below = self._config.battery_below
        percent = None if battery is None else battery.percent
        if below is None or battery is None or percent is None:
            return self._call("battery", None, now_s, str)
        is_low = _beyond(
            percent < below and not battery.charging,
            is_clear=percent >= min(below + BATTERY_CLEAR_PERCENT, 100),
        )
        return self._call("battery", is_low, now_s, lambda: f"battery at {percent} %")

    def on_diagnostics(self, message: JsonObject, now_s: float) -> HelpCall | None:
        """A diagnostic_msgs/DiagnosticArray, which may name some of the components only."""
        statuses = message.get("status")
        for status in statuses if isinstance(statuses, list) else ():
            if isinstance(status, dict):
                self._note_component(status, now_s)
        self._forget_silent(now_s)
        failing = next((words for failed, words, _ in self._components.values() if failed), None)
        state = None if not self._components else failing is not None
        return self._call("diagnostics", state, now_s, lambda: f"error: {failing}")

    def on_pose(self, message: JsonObject, now_s: float) -> HelpCall | None:
        """Where the robot is, in a message that has a position somewhere."""
        point, fence = position_in(message), self._config.geofence
        if point is None or not fence:
            return self._call("geofence", None, now_s, str)
        margin_m = fence_margin_m(fence, point)
        is_out = _beyond(margin_m < 0, is_clear=margin_m >= FENCE_CLEAR_M)
        x, y = point
        return self._call(
            "geofence", is_out, now_s, lambda: f"outside its geofence at x {x:.1f} m, y {y:.1f} m"
        )

    def on_navigation(self, published: bool | None, now_s: float) -> HelpCall | None:
        """Whether the navigation's topic has just brought a message; None: nobody can know."""
        silent_s = self._config.navigation_silent_s
        if published is not False or silent_s is None:
            self._silent_since_s = None
            return self._call("navigation", False if published else None, now_s, str)
        if self._silent_since_s is None:
            self._silent_since_s = now_s
        is_silent = now_s - self._silent_since_s >= silent_s
        topic = self._config.navigation_topic
        return self._call(
            "navigation", is_silent or None, now_s, lambda: f"{topic} silent for {silent_s:g} s"
        )

    def _forget_silent(self, now_s: float) -> None:
        """Forget components that are gone, as when their node has ended: of them nothing is known."""
        components = self._components
        while components and now_s - next(iter(components.values()))[2] > COMPONENT_SILENT_S:
            del components[next(iter(components))]

    def _note_component(self, status: JsonObject, now_s: float) -> None:
        name, level = status.get("name"), level_in(status.get("level"))
        if not isinstance(name, str) or level is None:
            return
        words = f"{name}: {status.get('message')}" if status.get("message") else name
        self._components.pop(name, None)
        self._components[name] = (level == ERROR, words, now_s)
        if len(self._components) > MAX_COMPONENTS:
            del self._components[next(iter(self._components))]

    def _call(
        self,
        source: HelpSource,
        state: bool | None,
        now_s: float,
        reason: Callable[[], str],
    ) -> HelpCall | None:
        is_edge = self._edges.setdefault(source, Edge()).update(state, now_s)
        return HelpCall(source, printable(reason(), MAX_HELP_REASON)) if is_edge else None


def _beyond(is_beyond: bool, *, is_clear: bool) -> bool | None:
    """Return whether a threshold is passed; None: between it and where it is clear."""
    if is_beyond:
        return True
    return False if is_clear else None


def call_in(message: JsonObject) -> HelpCall | None:
    """Return what a std_msgs/String asks for: its text is the reason, or JSON with `reason` and `priority`."""
    text = message.get("data")
    if not isinstance(text, str):
        return None
    try:
        members: Mapping[str, object] = parse_object(text, "the message")
    except FieldError:
        members = {"reason": text}
    reason, priority = members.get("reason"), members.get("priority")
    words = printable(reason, MAX_HELP_REASON) if isinstance(reason, str) else ""
    call = HelpCall("robot", words or "no reason given")
    if type(priority) is int and 1 <= priority <= LOWEST_PRIORITY:
        return replace(call, priority=priority)
    return call


def position_in(message: JsonObject) -> Point | None:
    """Return x and y of an Odometry, a PoseStamped, one with covariance, or a flat pose; None: it has none."""
    while isinstance(message.get("pose"), dict):
        message = as_object(message["pose"], "pose")
    position = message.get("position", message)
    if not isinstance(position, dict):
        return None
    x, y = number_in(position, "x"), number_in(position, "y")
    return None if x is None or y is None else (x, y)


def level_in(value: object) -> int | None:
    """Return the level of a DiagnosticStatus, a number, or as some bridges write bytes; None: unreadable."""
    if isinstance(value, str):
        try:
            return octet_of(value)
        except ValueError:
            return None
    return value if type(value) is int else None


def fence_margin_m(fence: Sequence[Point], point: Point) -> float:
    """Return how far a point is inside a polygon, in metres; negative: outside."""
    sides = list(pairwise([*fence, fence[0]]))
    distance_m = min(_distance_m(point, *side) for side in sides)
    # An odd number of sides is crossed on the way to the far right.
    crossed = sum(_is_crossed(point, *side) for side in sides)
    return distance_m if crossed % 2 else -distance_m


def _is_crossed(point: Point, start: Point, end: Point) -> bool:
    (x, y), (x1, y1), (x2, y2) = point, start, end
    return (y1 > y) != (y2 > y) and x < x1 + (y - y1) * (x2 - x1) / (y2 - y1)


def _distance_m(point: Point, start: Point, end: Point) -> float:
    (x, y), (x1, y1), (x2, y2) = point, start, end
    length2 = (x2 - x1) ** 2 + (y2 - y1) ** 2
    along = ((x - x1) * (x2 - x1) + (y - y1) * (y2 - y1)) / length2 if length2 else 0.0
    # In this order, what overflows to NaN far outside is 0.
    share = min(max(0.0, along), 1.0)
    return math.hypot(x - x1 - share * (x2 - x1), y - y1 - share * (y2 - y1))
