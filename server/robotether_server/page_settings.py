"""Settings of a robot's drive page: how it moves, its cameras, and the requested video.

Part of a robot's settings (robot_settings.py), as `page`; docs/protocols.md describes every member. Relay and
robot read nothing of it, but for what the page asks of them within the robot's policy. Pure.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal, get_args

from robotether_server import setting_values
from robotether_server.problems import FieldInvalid
from robotether_server.setting_values import Bounds

Kind = Literal["differential", "holonomic", "ackermann"]
Turn = Literal[0, 90, 180, 270]

KINDS: tuple[Kind, ...] = get_args(Kind)
TURNS: tuple[Turn, ...] = get_args(Turn)
MAX_CAMERAS = 8
MAX_LABEL_LENGTH = 40
# A topic, or the name of a camera that only the agent knows (docs/media.md).
CAMERA_TOPIC = re.compile(r"/?[A-Za-z0-9_.-]+(?:/[A-Za-z0-9_.-]+)*")
MAX_CAMERA_TOPIC_LENGTH = 255


@dataclass(frozen=True)
class Camera:
    """A camera, in the order in which the page shows them."""

    topic: str
    name: str
    turned_deg: Turn = 0


@dataclass(frozen=True)
class PageSettings:
    """The page's settings, with what None stands for.

    Topics: found by their type; speeds: the guard's limit, or the usual; `width` and `height`: the camera's own;
    `hold_after_ms`: driving is never held because of an old picture.
    """

    kind: Kind = "differential"
    drive_topic: str | None = None
    max_speed_m_s: float | None = None
    max_turn_rad_s: float | None = None
    wheelbase_m: float | None = None
    cameras: tuple[Camera, ...] = ()
    quality_min: int = 20
    quality_max: int = 80
    fps: float = 15
    latency_ms: int = 300
    width: int | None = None
    height: int | None = None
    hold_after_ms: int | None = 1000
    odometry_topic: str | None = None
    scan_topic: str | None = None
    map_topic: str | None = None
    battery_topic: str | None = None
    diagnostics_topic: str | None = None

    def as_dict(self) -> dict[str, object]:
        """Return the JSON members, all of them."""
        values = {known.name: getattr(self, known.name) for known in fields(self)}
        return {**values, "cameras": [dict(vars(camera)) for camera in self.cameras]}


DEFAULTS = PageSettings()
NAMES = tuple(known.name for known in fields(PageSettings))
TOPICS = tuple(name for name in NAMES if name.endswith("_topic"))
MAY_BE_NULL = frozenset(
    (*TOPICS, "max_speed_m_s", "max_turn_rad_s", "wheelbase_m", "width", "height", "hold_after_ms")
)
# What is wanted of a picture is as in docs/media.md. No speed here takes the guard's out of force: the page
# keeps to the lesser of both.
REAL_NUMBERS: Mapping[str, Bounds] = {
    "max_speed_m_s": Bounds(0.001, 100),
    "max_turn_rad_s": Bounds(0.001, 100),
    "wheelbase_m": Bounds(0.01, 100),
    "fps": Bounds(0.1, 60),
}
WHOLE_NUMBERS: Mapping[str, Bounds] = {
    "quality_min": Bounds(1, 100),
    "quality_max": Bounds(1, 100),
    "latency_ms": Bounds(50, 5000),
    "width": Bounds(1, 4096),
    "height": Bounds(1, 4096),
    "hold_after_ms": Bounds(300, 10_000),
}


def parse(given: object) -> PageSettings:
    """Return what this JSON object means; raise FieldInvalid, which names the member."""
    present = setting_values.members(given, "page", NAMES)
    values = {name: _value(name, value, f"page.{name}") for name, value in present.items()}
    page = PageSettings(**values)
    if page.quality_min > page.quality_max:
        raise FieldInvalid(
            f"cannot use page.quality_min: {page.quality_min} is over page.quality_max, {page.quality_max}"
        )
    if (page.width is None) != (page.height is None):
        raise FieldInvalid("cannot use page.width: give width and height, or neither")
    return page


def _value(name: str, value: object, path: str) -> Any:
    if name == "kind":
        return setting_values.choice(value, path, KINDS)
    if name == "cameras":
        return _cameras(value)
    if value is None and name in MAY_BE_NULL:
        return None
    if name in TOPICS:
        return setting_values.ros_name(value, path)
    return _number(name, value, path)


def _number(name: str, value: object, path: str) -> float:
    instead = "null or " if name in MAY_BE_NULL else ""
    if name in REAL_NUMBERS:
        return setting_values.number(value, path, REAL_NUMBERS[name], instead)
    return setting_values.whole(value, path, WHOLE_NUMBERS[name], instead)


def _cameras(given: object) -> tuple[Camera, ...]:
    each = setting_values.listed(given, "page.cameras", MAX_CAMERAS, "cameras")
    cameras = tuple(_camera(one, f"page.cameras.{place}") for place, one in enumerate(each, 1))
    topics = [camera.topic for camera in cameras]
    for topic in topics:
        if topics.count(topic) > 1:
            raise FieldInvalid(f"cannot use page.cameras: {topic} is there twice")
    return cameras


def _camera(given: object, path: str) -> Camera:
    present = setting_values.members(given, path, ("topic", "name", "turned_deg"))
    turned = present.get("turned_deg", 0)
    if isinstance(turned, bool) or turned not in TURNS:
        raise FieldInvalid(f"cannot use {path}.turned_deg: it must be 0, 90, 180 or 270")
    return Camera(
        _camera_topic(present.get("topic"), f"{path}.topic"),
        setting_values.label(present.get("name"), f"{path}.name", MAX_LABEL_LENGTH),
        # 90.0 is 90.
        TURNS[TURNS.index(turned)],
    )


def _camera_topic(given: object, path: str) -> str:
    fits = isinstance(given, str) and len(given) <= MAX_CAMERA_TOPIC_LENGTH
    if not isinstance(given, str) or not fits or not CAMERA_TOPIC.fullmatch(given):
        raise FieldInvalid(
            f"cannot use {path}: it must be a topic such as /camera/image_raw, or the name of a camera of the agent's"
        )
    return given
