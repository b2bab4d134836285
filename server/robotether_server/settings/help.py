"""When a robot asks a person for help by itself; part of a robot's settings (`settings.robot`), as `help`.

The relay passes them to the agent, which reads the topics and applies the rules; it keeps the pool. Pure.
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct, structs

from robotether_server.problems import FieldInvalidError
from robotether_server.schemas import MAX_NAME_LENGTH, PLAIN_NAME_PATTERN, RosName, setting

OnOff = Literal["off", "on"]
ON_OFF = {"off": "No", "on": "Yes"}
MIN_CORNERS, MAX_CORNERS, MAX_COORDINATE_M = 3, 32, 1e7


def _corners(raw: object, path: str) -> tuple[tuple[float, float], ...]:
    """Return the corners of a geofence; raise FieldInvalidError."""
    if isinstance(raw, list | tuple) and MIN_CORNERS <= len(raw) <= MAX_CORNERS:
        corners = [corner for item in raw if (corner := _corner(item)) is not None]
        if len(corners) == len(raw):
            return tuple(corners)
    raise FieldInvalidError(
        f"cannot use {path}: it must be null or {MIN_CORNERS} to {MAX_CORNERS} corners, each of two numbers, "
        f"x and y, from {-MAX_COORDINATE_M:.0f} to {MAX_COORDINATE_M:.0f}",
        path,
    )


def _corner(raw: object) -> tuple[float, float] | None:
    if not isinstance(raw, list | tuple) or len(raw) != 2:  # noqa: PLR2004 - x and y
        return None
    # A truth value is a number to Python, and NaN is in no range.
    if any(type(value) not in (int, float) or not abs(value) <= MAX_COORDINATE_M for value in raw):
        return None
    return float(raw[0]), float(raw[1])


Coordinate = Annotated[float, Meta(ge=-MAX_COORDINATE_M, le=MAX_COORDINATE_M)]
Corners = Annotated[
    tuple[tuple[Coordinate, Coordinate], ...],
    Meta(min_length=MIN_CORNERS, max_length=MAX_CORNERS, extra={"read": _corners}),
]
Pool = Annotated[
    str,
    Meta(
        min_length=1,
        max_length=MAX_NAME_LENGTH,
        pattern=PLAIN_NAME_PATTERN,
        extra={
            "exact": True,
            "must": f"1 to {MAX_NAME_LENGTH} of a-z, 0-9, ., _ and -, and begin with a letter or a digit",
        },
    ),
]


class HelpSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """When the robot asks for help, and whom; null is off."""

    topic: Annotated[
        RosName | None,
        setting(
            "Topic",
            "A std_msgs/String there is the reason.",
            empty="none",
            box="A program on the robot may ask",
        ),
    ] = "/robotether/help"
    pool: Annotated[
        Pool | None, setting("Pool", "The operators who get its requests.", empty="all operators")
    ] = None
    stopped: Annotated[OnOff, setting("When it is stopped", options=ON_OFF)] = "off"
    battery_below: Annotated[
        Annotated[int, Meta(ge=1, le=95)] | None,
        setting(
            "When its battery is below",
            "And it is not being charged.",
            unit="%",
            empty="never",
        ),
    ] = None
    diagnostics: Annotated[
        OnOff, setting("When its diagnostics report an error", options=ON_OFF)
    ] = "off"
    geofence: Annotated[
        Corners | None,
        setting(
            "When it leaves this area",
            "x and y of each corner in metres, in the frame of the pose's topic.",
            typed="One corner a line: 2.5 -1.",
            empty="never",
        ),
    ] = None
    pose_topic: Annotated[
        RosName | None,
        setting(
            "Topic of its pose",
            "Odometry, or a pose with or without covariance.",
            empty="its odometry",
        ),
    ] = None
    navigation_topic: Annotated[
        RosName | None,
        setting(
            "Topic of its navigation", "One that it always publishes while it works.", empty="none"
        ),
    ] = None
    navigation_silent_s: Annotated[
        Annotated[int, Meta(ge=20, le=86_400)] | None,
        setting("When its navigation is silent for", unit="s", empty="never"),
    ] = None

    def as_dict(self) -> dict[str, object]:
        """Return the JSON members, all of them."""
        corners = None if self.geofence is None else [list(corner) for corner in self.geofence]
        return {**structs.asdict(self), "geofence": corners}


DEFAULTS = HelpSettings()


def check(settings: HelpSettings) -> HelpSettings:
    """Return the settings; raise FieldInvalidError where they do not fit together."""
    if settings.navigation_silent_s is not None and settings.navigation_topic is None:
        raise FieldInvalidError(
            "cannot use help.navigation_silent_s: give help.navigation_topic too",
            "help.navigation_topic",
        )
    return settings
