"""The fields of a robot's settings, with what each means, by the tabs in which they stand; in the order shown.

docs/reference/robot-settings.md has what no form says. The cameras and the buttons have rows of their own.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from msgspec import inspect

from robotether_server import schemas
from robotether_server.problems import FieldInvalidError
from robotether_server.schemas import Level
from robotether_server.settings import robot as robot_settings
from robotether_server.settings.robot import GivenSettings, get_path, is_in
from robotether_server.web import forms

CAMERAS_PATH = "page.cameras"
LEVELS: tuple[tuple[Level, str, str], ...] = (
    ("observe", "Observers", "What people who only watch may read."),
    ("drive", "Drivers", "What drivers may read, publish and call."),
    ("manage", "Managers", "What managers may read, publish and call while driving."),
)
# Number of digits after the point of an angle in degrees.
DEGREES_DIGITS = 3
Kind = Literal["globs", "points", "number", "whole", "topic", "choice"]
KINDS: Mapping[type[inspect.Type], Kind] = {
    inspect.CustomType: "globs",
    inspect.FloatType: "number",
    inspect.IntType: "whole",
    inspect.StrType: "topic",
    inspect.LiteralType: "choice",
    inspect.VarTupleType: "points",
}


@dataclass(frozen=True)
class SettingField:
    """One setting: its path in the settings, and its texts.

    `empty` is shown for a missing value; without it a value is required. `box` is the label of a checkbox without which
    there is no value. `options` are pairs of value and words, of a choice. `beside` is the path of the setting whose
    value stands beside it. An angle is kept in radians, and shown and typed `in_degrees`.
    """

    path: str
    title: str
    label: str
    hint: str
    kind: Kind
    empty: str = ""
    box: str = ""
    box_hint: str = ""
    options: tuple[tuple[str, str], ...] = ()
    beside: str = ""
    in_degrees: bool = False

    def text_of(self, value: object) -> str:
        """Return a value as the text of this field."""
        if self.kind == "points" and isinstance(value, list | tuple):
            return "\n".join(" ".join(map(forms.value_text, point)) for point in value)
        if self.in_degrees and isinstance(value, int | float):
            value = round(math.degrees(value), DEGREES_DIGITS)
        return forms.value_text(value)

    def value_of(self, text: str) -> object:
        """Return the number that a text means, of points all; one that is none stays a text."""
        if self.kind == "points":
            lines = text.splitlines()
            return [[forms.number_or_text(part) for part in line.split()] for line in lines]
        value = forms.number_or_text(text, whole=self.kind == "whole")
        return math.radians(value) if self.in_degrees and isinstance(value, float) else value


def _field(path: str) -> SettingField:
    """Return the field of a setting, as its Struct describes it."""
    member = schemas.member(GivenSettings, path)
    kind, extra = KINDS[type(member.kind)], member.extra
    title, unit = member.words["title"], extra.get("unit", "")
    has_bounds = kind == "whole" or (kind == "number" and not member.may_be_null)
    bounds = f"{member.kind.ge} to {member.kind.le}." if has_bounds else ""
    hint = (bounds, member.words.get("description", ""), extra.get("typed", ""))
    return SettingField(
        path,
        title,
        f"{title} ({unit})" if unit else title,
        " ".join(filter(None, hint)),
        kind,
        extra.get("empty", "none" if kind == "globs" else ""),
        extra.get("box", ""),
        extra.get("box_hint", ""),
        tuple(extra.get("options", {}).items()),
        extra.get("beside", ""),
        in_degrees=unit.startswith("°"),
    )


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
    has_reset: bool = False

    @property
    def fields(self) -> Iterator[SettingField]:
        """All fields, in the order of the form."""
        return (field for section in (*self.sections, *self.more) for field in section.fields)


def _section(title: str, about: str, part: str, names: str) -> Section:
    return Section(title, about, tuple(_field(f"{part}.{name}") for name in names.split()))


SAFETY = Tab(
    "Safety",
    "",
    "The guard on the robot enforces these limits, whatever happens to the link. A change applies at once.",
    sections=(
        _section(
            "Speed and stops", "", "guard", "max_speed_m_s max_turn_rad_s deadman_ms max_age_ms"
        ),
        _section(
            "Slower when the driver sees late",
            "For drivers whose page says which frames it shows, as this server's pages do.",
            "guard",
            "blind_m blind_deg camera_ms without_frames",
        ),
    ),
    more_words="drive topics, acceleration, steering",
    more=(
        _section(
            "Acceleration and steering",
            "",
            "guard",
            "max_acceleration_m_s2 max_turn_acceleration_rad_s2 max_steering_rad",
        ),
        _section(
            "Topics that the guard watches",
            "A change stops the robot and disconnects everyone. They must reopen the page.",
            "guard",
            "drive_topics",
        ),
    ),
    saved="The safety settings of robot {name} are saved.",
    is_for_admins=True,
    has_reset=True,
)
CAMERAS = Tab(
    "Cameras",
    "/cameras",
    sections=(
        _section(
            "Video",
            "What the drive page requests. Quality and size follow the link within these bounds.",
            "page",
            "video quality_min quality_max fps latency_ms",
        ),
    ),
    more_words="size of the video, topics of map and readings",
    more=(
        _section("Size of the video", "Both, or neither.", "page", "width height"),
        _section(
            "Topics",
            "Full names.",
            "page",
            "odometry_topic scan_topic map_topic battery_topic battery_unit diagnostics_topic",
        ),
    ),
    saved="The cameras of robot {name} are saved. Open pages keep the old ones.",
)
DRIVING = Tab(
    "Driving",
    "/driving",
    sections=(
        _section("The robot", "", "page", "kind wheelbase_m drive_topic drive_type"),
        _section(
            "Speed of the controls",
            "The most that the drive page offers. The guard's own limits always hold.",
            "page",
            "max_speed_m_s max_turn_rad_s",
        ),
        _section("Frozen video", "", "page", "hold_after_ms"),
    ),
    saved="The driving settings of robot {name} are saved. Open pages keep the old ones.",
)
BUTTONS = Tab("Buttons", "/buttons")
HELP = Tab(
    "Requests",
    "/help",
    "When the robot asks a person for help by itself. It asks once, and again only after it was well in between.",
    sections=(
        _section("A program on the robot asks", "", "help", "topic pool"),
        _section("The robot asks", "", "help", "stopped battery_below diagnostics"),
        _section("Where it is", "", "help", "geofence pose_topic"),
        _section("What it does", "", "help", "navigation_topic navigation_silent_s"),
    ),
    saved="The rules by which robot {name} asks for help are saved.",
    is_for_admins=True,
)
PERMISSIONS = Tab(
    "Permissions",
    "/permissions",
    "What people may read from the robot and send to it, by their grant. Full names of topics and services, one a "
    "line; * stands for any text: /arm/*, */cmd_vel, *. A change stops the robot and disconnects everyone. They must "
    "reopen the page.",
    sections=tuple(
        _section(title, about, f"policy.{level}", " ".join(robot_settings.LEVEL_MEMBERS[level]))
        for level, title, about in LEVELS
    ),
    more_words="limits of each connection",
    more=(
        _section(
            "Limits of each connection",
            "What exceeds them is refused, and counted in the list of drives.",
            "policy.limits",
            "subscriptions messages_per_s message_kb",
        ),
    ),
    saved="The permissions of robot {name} are saved.",
    is_for_admins=True,
    has_reset=True,
)
RECORDING = Tab(
    "Recording",
    "/recording",
    "Recordings are listed below Recordings, for those who manage the robot.",
    sections=(_section("When", "", "recording", "when"),),
    saved="The recording settings of robot {name} are saved.",
    is_for_admins=True,
)
TABS = (SAFETY, CAMERAS, DRIVING, BUTTONS, PERMISSIONS, HELP, RECORDING)
_FIELDS = {field.path: field for tab in TABS for field in tab.fields}


def summary(settings: Mapping[str, object]) -> list[tuple[str, str]]:
    """Return what of safety and permissions differs from the defaults, as labels and texts."""
    try:
        differences = robot_settings.parse(settings).as_given()
    except FieldInvalidError as error:
        # Somebody wrote by SQL what nobody may set.
        return [("Not valid", error.detail)]
    return [
        # Only the levels' fields have one label several times.
        (
            field.label if tab is SAFETY else f"{section.title}: {field.label}",
            line_of(field, get_path(differences, field.path)),
        )
        for tab in (SAFETY, PERMISSIONS)
        for section in (*tab.sections, *tab.more)
        for field in section.fields
        if is_in(differences, field.path)
    ]


def line_of(field: SettingField, value: object) -> str:
    """Return a value as one line; nothing has words of its own."""
    return field.text_of(value).replace("\n", ", ") or field.empty


def beside(field: SettingField, settings: Mapping[str, object]) -> str:
    """Return the setting that belongs beside this one, with its value."""
    other = _FIELDS[field.beside]
    return f"{other.title}: {line_of(other, get_path(settings, other.path))}."
