"""The fields of the form for a robot's policy and guard, with what each means; in the order in which they are shown."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from robotether_server import robot_settings
from robotether_server.problems import FieldInvalid
from robotether_server.robot_settings import get_path, is_in
from robotether_server.web import forms


@dataclass(frozen=True)
class SettingField:
    """One setting: its path in the settings, and its texts. `empty` is shown for a missing value."""

    path: str
    label: str
    hint: str
    kind: Literal["globs", "limit", "whole"]
    empty: str = "no limit"


@dataclass(frozen=True)
class Section:
    """Settings that belong together."""

    title: str
    about: str
    fields: tuple[SettingField, ...]


def _globs(path: str, label: str, hint: str) -> SettingField:
    return SettingField(path, label, hint, "globs", "none")


def _limit(path: str, label: str, hint: str) -> SettingField:
    return SettingField(path, label, hint, "limit")


def _whole(path: str, label: str, hint: str) -> SettingField:
    return SettingField(path, label, hint, "whole")


SECTIONS: tuple[Section, ...] = (
    Section(
        "Guard on the robot",
        "It limits drive commands on the robot itself, and stops the robot when no more commands come.",
        (
            _globs(
                "guard.drive_topics",
                "Drive topics",
                "Topics that move the robot: Twist, TwistStamped or AckermannDriveStamped.",
            ),
            _whole(
                "guard.deadman_ms",
                "Stop if no command arrives for (ms)",
                "200 to 2000. Counted from the last command that moves the robot.",
            ),
            _whole(
                "guard.max_age_ms",
                "Ignore commands older than (ms)",
                "200 to 2000. Their age is checked when they arrive.",
            ),
            _limit("guard.max_speed_m_s", "Top speed (m/s)", "Faster commands are reduced to it."),
            _limit("guard.max_turn_rad_s", "Top turn (rad/s)", "Faster turns are reduced to it."),
            _limit(
                "guard.max_acceleration_m_s2",
                "Top acceleration (m/s²)",
                "Limited only while the speed grows; braking is never delayed.",
            ),
            _limit(
                "guard.max_turn_acceleration_rad_s2",
                "Top turn acceleration (rad/s²)",
                "Limited only while the turn grows.",
            ),
            _limit(
                "guard.max_steering_rad",
                "Maximum steering angle (rad)",
                "For robots that steer like a car.",
            ),
        ),
    ),
    Section(
        "Observers",
        "What people who only watch may read.",
        (_globs("policy.observe.subscribe", "Subscribe to", "Topics that they may subscribe to."),),
    ),
    Section(
        "Drivers",
        "What drivers may read, publish and call.",
        (
            _globs("policy.drive.subscribe", "Subscribe to", "Topics that they may subscribe to."),
            _globs(
                "policy.drive.publish",
                "Publish to",
                "Topics in addition to the drive topics.",
            ),
            _globs(
                "policy.drive.call",
                "Call",
                "Services and actions, in addition to the look-ups of /rosapi.",
            ),
        ),
    ),
    Section(
        "Managers",
        "What managers may read, publish and call while driving.",
        (
            _globs("policy.manage.subscribe", "Subscribe to", "Topics that they may subscribe to."),
            _globs(
                "policy.manage.publish",
                "Publish to",
                "Topics in addition to the drive topics.",
            ),
            _globs(
                "policy.manage.call",
                "Call",
                "Services and actions, in addition to the look-ups of /rosapi.",
            ),
            _globs(
                "policy.manage.serve",
                "Serve",
                "Services and actions that they may offer to the robot.",
            ),
        ),
    ),
    Section(
        "Limits of each connection",
        "What exceeds them is refused, and counted in the list of drives.",
        (
            _whole("policy.limits.subscriptions", "Subscriptions", "1 to 10000."),
            _whole("policy.limits.messages_per_s", "Messages a second", "1 to 100000."),
            _whole("policy.limits.message_kb", "Largest message (KB)", "1 to 10240."),
        ),
    ),
)


def summary(settings: Mapping[str, object]) -> list[tuple[str, str]]:
    """Return what of policy and guard differs from the defaults, as labels and texts."""
    try:
        given = robot_settings.parse(settings).as_given()
    except FieldInvalid as error:
        # Somebody wrote by SQL what nobody may set.
        return [("Not valid", error.detail)]
    return [
        (f"{section.title}: {field.label}", line_of(field, get_path(given, field.path)))
        for section in SECTIONS
        for field in section.fields
        if is_in(given, field.path)
    ]


def line_of(field: SettingField, value: object) -> str:
    """Return a value as one line; nothing has words of its own."""
    return forms.value_text(value).replace("\n", ", ") or field.empty
