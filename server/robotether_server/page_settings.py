"""Settings of a robot's drive page: how it moves, its cameras, and the requested video.

Part of a robot's settings (robot_settings.py), as `page`; docs/reference/robot-settings.md describes every member.
The relay reads none of it and passes what concerns the battery to the agent; the page asks relay and robot within the
robot's policy. Pure.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal, get_args

from msgspec import Meta, Struct, structs

from robotether_server import schemas
from robotether_server.problems import FieldInvalidError
from robotether_server.schemas import RosName

Kind = Literal["differential", "holonomic", "ackermann"]
DriveType = Literal[
    "geometry_msgs/Twist", "geometry_msgs/TwistStamped", "ackermann_msgs/AckermannDriveStamped"
]
# What 1 means in the `percentage` of a sensor_msgs/BatteryState: all, or a hundredth.
BatteryUnit = Literal["fraction", "percent"]
Turn = Literal[0, 90, 180, 270]

TURNS: tuple[Turn, ...] = get_args(Turn)
MAX_CAMERAS = 8
MAX_LABEL_LENGTH = 40
# A topic, or the name of a camera that only the agent knows (docs/reference/media.md).
CameraTopic = Annotated[
    str,
    Meta(
        min_length=1,
        max_length=255,
        pattern="^/?[A-Za-z0-9_.-]+(/[A-Za-z0-9_.-]+)*$",
        extra={
            "exact": True,
            "must": "a topic such as /camera/image_raw, or the name of a camera of the agent's",
        },
    ),
]
# The guard's limits stay in force: the page offers the lower of both.
Speed = Annotated[float, Meta(ge=0.001, le=100)]
Percent = Annotated[int, Meta(ge=1, le=100)]
Pixels = Annotated[int, Meta(ge=1, le=4096)]


class Camera(Struct, frozen=True, forbid_unknown_fields=True):
    """A camera; the page shows them in this order."""

    topic: CameraTopic
    name: Annotated[str, Meta(min_length=1, max_length=MAX_LABEL_LENGTH)]
    turned_deg: Turn = 0


class PageSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The drive page's settings of a robot; a missing member has its default.

    null means: a topic is found by its type; `drive_type` follows the robot's ROS; a speed is the guard's limit, or
    the page's usual one; `width` and `height` are the camera's own; `hold_after_ms`: driving is never paused
    because of old video.
    """

    kind: Kind = "differential"
    drive_topic: RosName | None = None
    drive_type: DriveType | None = None
    max_speed_m_s: Speed | None = None
    max_turn_rad_s: Speed | None = None
    wheelbase_m: Annotated[float, Meta(ge=0.01, le=100)] | None = None
    cameras: Annotated[tuple[Camera, ...], Meta(max_length=MAX_CAMERAS)] = ()
    # The stream request (docs/reference/media.md).
    quality_min: Percent = 20
    quality_max: Percent = 80
    fps: Annotated[float, Meta(ge=0.1, le=60)] = 15
    latency_ms: Annotated[int, Meta(ge=50, le=5000)] = 300
    width: Pixels | None = None
    height: Pixels | None = None
    hold_after_ms: Annotated[int, Meta(ge=300, le=10_000)] | None = 1000
    odometry_topic: RosName | None = None
    scan_topic: RosName | None = None
    map_topic: RosName | None = None
    battery_topic: RosName | None = None
    battery_unit: BatteryUnit | None = None
    diagnostics_topic: RosName | None = None

    def as_dict(self) -> dict[str, object]:
        """Return the JSON members, all of them."""
        cameras = [structs.asdict(camera) for camera in self.cameras]
        return {**structs.asdict(self), "cameras": cameras}


DEFAULTS = PageSettings()


def parse(given: Mapping[str, object]) -> PageSettings:
    """Return what this JSON object means; raise FieldInvalidError, which names the member."""
    return check(schemas.read(given, PageSettings, "page."))


def check(page: PageSettings) -> PageSettings:
    """Return the settings; raise FieldInvalidError where they do not fit together."""
    if page.quality_min > page.quality_max:
        raise FieldInvalidError(
            f"cannot use page.quality_min: {page.quality_min} is over the highest quality, {page.quality_max}",
            "page.quality_min",
        )
    if (page.width is None) != (page.height is None):
        raise FieldInvalidError(
            "cannot use page.width: give width and height, or neither", "page.width"
        )
    topics = [camera.topic for camera in page.cameras]
    for topic in topics:
        if topics.count(topic) > 1:
            raise FieldInvalidError(
                f"cannot use page.cameras: {topic} is there twice",
                f"page.cameras.{len(topics) - topics[::-1].index(topic)}.topic",
            )
    return page
