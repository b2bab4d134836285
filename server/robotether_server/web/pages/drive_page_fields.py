"""The fields of the form for a drive page, with what each means; in the order in which they are shown."""

from dataclasses import dataclass
from typing import Literal

from robotether_server.page_settings import Kind


@dataclass(frozen=True)
class PageField:
    """One member of `page` and its words. `empty` is said where nothing stands; without it there must be something."""

    name: str
    label: str
    hint: str
    kind: Literal["number", "topic"] = "number"
    empty: str = ""


KIND_WORDS: tuple[tuple[Kind, str], ...] = (
    ("differential", "Drives and turns (differential)"),
    ("holonomic", "Moves sideways too (holonomic)"),
    ("ackermann", "Steers as a car does (Ackermann)"),
)
MOVING = (
    PageField(
        "drive_topic",
        "Drive topic",
        "One of the guard's drive topics.",
        "topic",
        "the page finds it",
    ),
    PageField(
        "max_speed_m_s",
        "Top speed (m/s)",
        "The most that the controls offer. The guard's own limit holds whatever stands here.",
        empty="the guard's",
    ),
    PageField(
        "max_turn_rad_s", "Top turn (rad/s)", "As the top speed, for turning.", empty="the guard's"
    ),
    PageField("wheelbase_m", "Wheelbase (m)", "For robots that steer.", empty="not known"),
)
VIDEO = (
    PageField("quality_min", "Lowest quality", "1 to 100. A slow link gets down to it."),
    PageField("quality_max", "Highest quality", "1 to 100. A good link gets up to it."),
    PageField("fps", "Pictures a second", "0.1 to 60."),
    PageField("latency_ms", "Oldest picture to aim at (ms)", "50 to 5000."),
    PageField("width", "Width (pixels)", "With the height, or neither.", empty="the camera's own"),
    PageField("height", "Height (pixels)", "With the width, or neither.", empty="the camera's own"),
)
_BY_TYPE = "found by its type"
TOPICS = (
    PageField("odometry_topic", "Odometry", "For the path.", "topic", _BY_TYPE),
    PageField("scan_topic", "Laser scan", "Drawn around the robot.", "topic", _BY_TYPE),
    PageField("map_topic", "Map", "Drawn under the robot.", "topic", _BY_TYPE),
    PageField("battery_topic", "Battery", "How full it is.", "topic", _BY_TYPE),
    PageField("diagnostics_topic", "Diagnostics", "What its parts say.", "topic", _BY_TYPE),
)
FIELDS = (*MOVING, *VIDEO, *TOPICS)
