"""Settings of a robot's drive page: how it moves, its cameras, and the requested video.

Part of a robot's settings (`settings.robot`), as `page`; docs/reference/robot-settings.md has what no form says.
The relay reads none of it and passes what concerns the battery to the agent; the page asks relay and robot within the
robot's policy. Pure.
"""

from __future__ import annotations

from typing import Annotated, Literal, get_args

from msgspec import Meta, Struct, structs

from robotether_server.problems import FieldInvalidError
from robotether_server.schemas import RosName, setting

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
# Of the guard, too; the page offers the lower limit of both. No robot needs more; the lowest is next to rest.
Speed = Annotated[float, Meta(ge=0.001, le=100)]
Percent = Annotated[int, Meta(ge=1, le=100)]
Pixels = Annotated[int, Meta(ge=1, le=4096)]
CAMERAS_OWN = "the camera's own"


def _found_by_type(title: str, description: str) -> Meta:
    return setting(title, description, empty="found by its type")


class Camera(Struct, frozen=True, forbid_unknown_fields=True):
    """A camera; the page shows them in this order."""

    topic: Annotated[CameraTopic, setting("Topic")]
    name: Annotated[str, Meta(min_length=1, max_length=MAX_LABEL_LENGTH), setting("Name")]
    turned_deg: Annotated[Turn, setting("Turned by")] = 0


class PageSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The drive page's settings of a robot; a missing member has its default.

    null means: a topic is found by its type; `drive_type` follows the robot's ROS; a speed is the guard's limit, or
    the page's usual one; `width` and `height` are the camera's own; `hold_after_ms`: driving is never paused
    because of old video.
    """

    kind: Annotated[
        Kind,
        setting(
            "How it moves",
            options={
                "differential": "Drives and turns (differential)",
                "holonomic": "Moves sideways too (holonomic)",
                "ackermann": "Steers like a car (Ackermann)",
            },
        ),
    ] = "differential"
    drive_topic: Annotated[
        RosName | None,
        setting("Drive topic", "One of the guard's drive topics.", empty="the guard's first"),
    ] = None
    drive_type: Annotated[
        DriveType | None,
        setting(
            "Type of drive commands",
            "Used while the robot does not report the type of its drive topic.",
            empty="automatic",
            options={
                "": "Automatic, by the release of ROS",
                "geometry_msgs/Twist": "Twist",
                "geometry_msgs/TwistStamped": "TwistStamped",
                "ackermann_msgs/AckermannDriveStamped": "AckermannDriveStamped",
            },
        ),
    ] = None
    max_speed_m_s: Annotated[
        Speed | None,
        setting(
            "Driver's limit",
            "Without either limit the page offers 1 m/s.",
            unit="m/s",
            empty="the robot's limit",
            beside="guard.max_speed_m_s",
        ),
    ] = None
    max_turn_rad_s: Annotated[
        Speed | None,
        setting(
            "Driver's turn limit",
            "Without either limit the page offers 86 °/s.",
            unit="°/s",
            empty="the robot's limit",
            beside="guard.max_turn_rad_s",
        ),
    ] = None
    wheelbase_m: Annotated[
        Annotated[float, Meta(ge=0.01, le=100)] | None,
        setting("Wheelbase", "For robots that steer like a car.", unit="m", empty="not known"),
    ] = None
    cameras: Annotated[tuple[Camera, ...], Meta(max_length=MAX_CAMERAS)] = ()
    video: Annotated[
        Literal["expected", "none"],
        setting(
            "Video",
            "Used while the robot does not say whether it has a camera, as without rosapi.",
            options={"expected": "Expected", "none": "None: it has no camera"},
        ),
    ] = "expected"
    # The stream request (docs/reference/media.md).
    quality_min: Annotated[
        Percent, setting("Lowest quality", "On a slow link, quality falls to this.")
    ] = 20
    quality_max: Annotated[
        Percent, setting("Highest quality", "On a good link, quality rises to this.")
    ] = 80
    fps: Annotated[float, Meta(ge=0.1, le=60), setting("Frames a second")] = 15
    latency_ms: Annotated[
        int, Meta(ge=50, le=5000), setting("Highest age to aim for", unit="ms")
    ] = 300
    width: Annotated[Pixels | None, setting("Width", unit="pixels", empty=CAMERAS_OWN)] = None
    height: Annotated[Pixels | None, setting("Height", unit="pixels", empty=CAMERAS_OWN)] = None
    hold_after_ms: Annotated[
        Annotated[int, Meta(ge=300, le=10_000)] | None,
        setting(
            "Frozen after",
            unit="ms",
            empty="never",
            box="Stop driving when the video freezes",
            box_hint="If it is off, people may drive by a frozen picture. A driver can also choose once to drive "
            "without video.",
        ),
    ] = 1000
    odometry_topic: Annotated[RosName | None, _found_by_type("Odometry", "For the path.")] = None
    scan_topic: Annotated[
        RosName | None, _found_by_type("Laser scan", "Drawn around the robot.")
    ] = None
    map_topic: Annotated[RosName | None, _found_by_type("Map", "Drawn under the robot.")] = None
    battery_topic: Annotated[RosName | None, _found_by_type("Battery", "How full it is.")] = None
    battery_unit: Annotated[
        BatteryUnit | None,
        setting(
            "Battery counts",
            "Set this if the battery shows ? or a wrong level.",
            empty="automatic",
            options={
                "": "Automatic, by what it has shown",
                "fraction": "From 0 to 1",
                "percent": "From 0 to 100",
            },
        ),
    ] = None
    diagnostics_topic: Annotated[
        RosName | None, _found_by_type("Diagnostics", "What its parts say.")
    ] = None

    def as_dict(self) -> dict[str, object]:
        """Return the JSON members, all of them."""
        cameras = [structs.asdict(camera) for camera in self.cameras]
        return {**structs.asdict(self), "cameras": cameras}


DEFAULTS = PageSettings()


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
    if page.cameras and page.video == "none":
        raise FieldInvalidError(
            "cannot use page.video: the page has cameras; remove them, or expect video",
            "page.video",
        )
    topics = [camera.topic for camera in page.cameras]
    for topic in topics:
        if topics.count(topic) > 1:
            raise FieldInvalidError(
                f"cannot use page.cameras: {topic} is there twice",
                f"page.cameras.{len(topics) - topics[::-1].index(topic)}.topic",
            )
    return page
