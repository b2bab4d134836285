"""The fields of a robot's settings, with what each means, by the tabs in which they stand; in the order shown.

docs/reference/robot-settings.md describes every setting. The cameras and the buttons have rows of their own.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from robotether_server import robot_settings
from robotether_server.page_settings import BatteryUnit, DriveType, Kind
from robotether_server.problems import FieldInvalidError
from robotether_server.robot_settings import get_path, is_in
from robotether_server.web import forms

KIND_WORDS: tuple[tuple[Kind, str], ...] = (
    ("differential", "Drives and turns (differential)"),
    ("holonomic", "Moves sideways too (holonomic)"),
    ("ackermann", "Steers like a car (Ackermann)"),
)
TYPE_WORDS: tuple[tuple[DriveType | Literal[""], str], ...] = (
    ("", "Automatic: TwistStamped from ROS 2 Jazzy on, else Twist"),
    ("geometry_msgs/Twist", "Twist"),
    ("geometry_msgs/TwistStamped", "TwistStamped"),
    ("ackermann_msgs/AckermannDriveStamped", "AckermannDriveStamped"),
)
BATTERY_WORDS: tuple[tuple[BatteryUnit | Literal[""], str], ...] = (
    ("", "Automatic: by what the robot has shown"),
    ("fraction", "From 0 to 1"),
    ("percent", "From 0 to 100"),
)
CAMERAS_PATH = "page.cameras"
# Number of digits after the point of an angle in degrees.
DEGREES_DIGITS = 3


@dataclass(frozen=True)
class SettingField:
    """One setting: its path in the settings, and its texts.

    `empty` is shown for a missing value; without it a value is required. `box` is the label of a checkbox without which
    there is no value. `options` are pairs of value and words, of a choice. `beside` is the path of the setting whose
    value stands beside it. An angle is kept in radians, and shown and typed `in_degrees`.
    """

    path: str
    label: str
    hint: str
    kind: Literal["globs", "number", "whole", "topic", "choice"] = "number"
    empty: str = ""
    box: str = ""
    box_hint: str = ""
    options: tuple[tuple[str, str], ...] = ()
    beside: str = ""
    in_degrees: bool = False

    def text_of(self, value: object) -> str:
        """Return a value as the text of this field."""
        if self.in_degrees and isinstance(value, int | float):
            value = round(math.degrees(value), DEGREES_DIGITS)
        return forms.value_text(value)

    def value_of(self, text: str) -> object:
        """Return the number that a text means; one that is none stays a text."""
        value = forms.number_or_text(text, whole=self.kind == "whole")
        return math.radians(value) if self.in_degrees and isinstance(value, float) else value


@dataclass(frozen=True)
class Section:
    """Settings that belong together."""

    title: str
    about: str
    fields: tuple[SettingField, ...]


@dataclass(frozen=True)
class Tab:
    """A tab: its title, its address below the settings, and its sections; `more` are those that are rarely needed."""

    title: str
    path: str
    about: str = ""
    sections: tuple[Section, ...] = ()
    more: tuple[Section, ...] = ()
    more_words: str = ""
    saved: str = ""
    is_for_admins: bool = False

    @property
    def fields(self) -> Iterator[SettingField]:
        """All fields, in the order of the form."""
        return (field for section in (*self.sections, *self.more) for field in section.fields)


def _globs(path: str, label: str, hint: str) -> SettingField:
    return SettingField(path, label, hint, "globs", "none")


def _limit(
    path: str, label: str, hint: str, *, beside: str = "", in_degrees: bool = False
) -> SettingField:
    return SettingField(path, label, hint, empty="no limit", beside=beside, in_degrees=in_degrees)


def _whole(path: str, label: str, hint: str, empty: str = "") -> SettingField:
    return SettingField(path, label, hint, "whole", empty)


def _topic(path: str, label: str, hint: str) -> SettingField:
    return SettingField(path, label, hint, "topic", "found by its type")


def _level(name: str, title: str, about: str, *more: SettingField) -> Section:
    subscribe = _globs(
        f"policy.{name}.subscribe", "Subscribe to", "Topics that they may subscribe to."
    )
    return Section(title, about, (subscribe, *more))


def _publish_and_call(name: str) -> tuple[SettingField, SettingField]:
    return (
        _globs(f"policy.{name}.publish", "Publish to", "Topics in addition to the drive topics."),
        _globs(
            f"policy.{name}.call",
            "Call",
            "Services and actions, in addition to the look-ups of /rosapi.",
        ),
    )


SAFETY = Tab(
    "Safety",
    "",
    "The guard on the robot enforces these limits, whatever happens to the link. A change applies at once.",
    sections=(
        Section(
            "Speed and stops",
            "",
            (
                _limit(
                    "guard.max_speed_m_s",
                    "Robot's limit (m/s)",
                    "Faster commands are reduced to it.",
                    beside="page.max_speed_m_s",
                ),
                _limit(
                    "guard.max_turn_rad_s",
                    "Robot's turn limit (°/s)",
                    "Faster turns are reduced to it.",
                    beside="page.max_turn_rad_s",
                    in_degrees=True,
                ),
                _whole(
                    "guard.deadman_ms",
                    "Stop if no command arrives for (ms)",
                    "200 to 2000. Counted from the last command that moves the robot.",
                ),
                _whole(
                    "guard.max_age_ms",
                    "Ignore commands older than (ms)",
                    "200 to 2000. Their age is checked when they arrive. A change stops the robot and disconnects "
                    "everyone.",
                ),
            ),
        ),
    ),
    more_words="drive topics, acceleration, steering",
    more=(
        Section(
            "Acceleration and steering",
            "",
            (
                _limit(
                    "guard.max_acceleration_m_s2",
                    "Top acceleration (m/s²)",
                    "Limited only while the speed grows; braking is never delayed.",
                ),
                _limit(
                    "guard.max_turn_acceleration_rad_s2",
                    "Top turn acceleration (°/s²)",
                    "Limited only while the turn grows.",
                    in_degrees=True,
                ),
                _limit(
                    "guard.max_steering_rad",
                    "Maximum steering angle (°)",
                    "For robots that steer like a car.",
                    in_degrees=True,
                ),
            ),
        ),
        Section(
            "Topics that the guard watches",
            "A change stops the robot and disconnects everyone. They must reopen the page.",
            (
                _globs(
                    "guard.drive_topics",
                    "Drive topics",
                    "Topics that move the robot: Twist, TwistStamped or AckermannDriveStamped. Full names, one a line; "
                    "* stands for any text.",
                ),
            ),
        ),
    ),
    saved="The safety settings of robot {name} are saved.",
    is_for_admins=True,
)
CAMERAS = Tab(
    "Cameras",
    "/cameras",
    sections=(
        Section(
            "Video",
            "What the drive page requests. Quality and size follow the link within these bounds.",
            (
                _whole(
                    "page.quality_min",
                    "Lowest quality",
                    "1 to 100. On a slow link, quality falls to this.",
                ),
                _whole(
                    "page.quality_max",
                    "Highest quality",
                    "1 to 100. On a good link, quality rises to this.",
                ),
                SettingField("page.fps", "Frames a second", "0.1 to 60."),
                _whole("page.latency_ms", "Highest age to aim for (ms)", "50 to 5000."),
            ),
        ),
    ),
    more_words="size of the video, topics of map and readings",
    more=(
        Section(
            "Size of the video",
            "Both, or neither.",
            (
                _whole("page.width", "Width (pixels)", "1 to 4096.", "the camera's own"),
                _whole("page.height", "Height (pixels)", "1 to 4096.", "the camera's own"),
            ),
        ),
        Section(
            "Topics",
            "Full names.",
            (
                _topic("page.odometry_topic", "Odometry", "For the path."),
                _topic("page.scan_topic", "Laser scan", "Drawn around the robot."),
                _topic("page.map_topic", "Map", "Drawn under the robot."),
                _topic("page.battery_topic", "Battery", "How full it is."),
                SettingField(
                    "page.battery_unit",
                    "Battery counts",
                    "Set this if the battery shows ? or a wrong level.",
                    "choice",
                    "automatic",
                    options=BATTERY_WORDS,
                ),
                _topic("page.diagnostics_topic", "Diagnostics", "What its parts say."),
            ),
        ),
    ),
    saved="The cameras of robot {name} are saved. Open pages keep the old ones.",
)
DRIVING = Tab(
    "Driving",
    "/driving",
    sections=(
        Section(
            "The robot",
            "",
            (
                SettingField("page.kind", "How it moves", "", "choice", options=KIND_WORDS),
                SettingField(
                    "page.wheelbase_m",
                    "Wheelbase (m)",
                    "For robots that steer like a car.",
                    empty="not known",
                ),
                SettingField(
                    "page.drive_topic",
                    "Drive topic",
                    "One of the guard's drive topics.",
                    "topic",
                    "the guard's first",
                ),
                SettingField(
                    "page.drive_type",
                    "Type of drive commands",
                    "Used while the robot does not report the type of its drive topic.",
                    "choice",
                    "automatic",
                    options=TYPE_WORDS,
                ),
            ),
        ),
        Section(
            "Speed of the controls",
            "The most that the drive page offers. The guard's own limits always hold.",
            (
                SettingField(
                    "page.max_speed_m_s",
                    "Driver's limit (m/s)",
                    "Without either limit the page offers 1 m/s.",
                    empty="the robot's limit",
                    beside="guard.max_speed_m_s",
                ),
                SettingField(
                    "page.max_turn_rad_s",
                    "Driver's turn limit (°/s)",
                    "Without either limit the page offers 86 °/s.",
                    empty="the robot's limit",
                    beside="guard.max_turn_rad_s",
                    in_degrees=True,
                ),
            ),
        ),
        Section(
            "Frozen video",
            "",
            (
                SettingField(
                    "page.hold_after_ms",
                    "Frozen after (ms)",
                    "300 to 10000.",
                    "whole",
                    "never",
                    box="Stop driving when the video freezes",
                    box_hint="If it is off, people may drive by a frozen picture. A driver can also choose once to "
                    "drive without video.",
                ),
            ),
        ),
    ),
    saved="The driving settings of robot {name} are saved. Open pages keep the old ones.",
)
BUTTONS = Tab("Buttons", "/buttons")
PERMISSIONS = Tab(
    "Permissions",
    "/permissions",
    "What people may read from the robot and send to it, by their grant. Full names of topics and services, one a "
    "line; * stands for any text: /arm/*, */cmd_vel, *. A change stops the robot and disconnects everyone. They must "
    "reopen the page.",
    sections=(
        _level("observe", "Observers", "What people who only watch may read."),
        _level(
            "drive",
            "Drivers",
            "What drivers may read, publish and call.",
            *_publish_and_call("drive"),
        ),
        _level(
            "manage",
            "Managers",
            "What managers may read, publish and call while driving.",
            *_publish_and_call("manage"),
            _globs(
                "policy.manage.serve",
                "Serve",
                "Services and actions that they may offer to the robot.",
            ),
        ),
    ),
    more_words="limits of each connection",
    more=(
        Section(
            "Limits of each connection",
            "What exceeds them is refused, and counted in the list of drives.",
            (
                _whole("policy.limits.subscriptions", "Subscriptions", "1 to 10000."),
                _whole("policy.limits.messages_per_s", "Messages a second", "1 to 100000."),
                _whole("policy.limits.message_kb", "Largest message (KB)", "1 to 10240."),
            ),
        ),
    ),
    saved="The permissions of robot {name} are saved.",
    is_for_admins=True,
)
TABS = (SAFETY, CAMERAS, DRIVING, BUTTONS, PERMISSIONS)
_FIELDS = {field.path: field for tab in TABS for field in tab.fields}


def summary(settings: Mapping[str, object]) -> list[tuple[str, str]]:
    """Return what of safety and permissions differs from the defaults, as labels and texts."""
    try:
        given = robot_settings.parse(settings).as_given()
    except FieldInvalidError as error:
        # Somebody wrote by SQL what nobody may set.
        return [("Not valid", error.detail)]
    return [
        # Only the levels' fields have one label several times.
        (
            field.label if tab is SAFETY else f"{section.title}: {field.label}",
            line_of(field, get_path(given, field.path)),
        )
        for tab in (SAFETY, PERMISSIONS)
        for section in (*tab.sections, *tab.more)
        for field in section.fields
        if is_in(given, field.path)
    ]


def line_of(field: SettingField, value: object) -> str:
    """Return a value as one line; nothing has words of its own."""
    return field.text_of(value).replace("\n", ", ") or field.empty


def beside(field: SettingField, settings: Mapping[str, object]) -> str:
    """Return the setting that belongs beside this one, with its value."""
    other = _FIELDS[field.beside]
    return f"{other.label.partition(' (')[0]}: {line_of(other, get_path(settings, other.path))}."
