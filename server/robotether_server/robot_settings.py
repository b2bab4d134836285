"""A robot's settings: the shell's account, its guard, who may send what, and what the drive page shows.

Kept in `robots.settings` as JSON that names only what differs from the defaults. Web and command
line check with `parse` what people give; the relay reads the same JSON and sends `guard` on to
the robot. docs/protocols.md describes every member. Must never take a member that it does not
know, or a number without bounds: a limit with a typing error would be no limit. The page's form and the command
line name members by paths such as guard.deadman_ms (`get_path`, `put_path`). Pure: what is given is never changed.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal

from robotether_server import buttons as button_settings
from robotether_server import page_settings, setting_values
from robotether_server.buttons import Button
from robotether_server.globs import Globs
from robotether_server.page_settings import PageSettings
from robotether_server.problems import FieldInvalid
from robotether_server.setting_values import Bounds

Level = Literal["observe", "drive", "manage"]

SHELL_USER = re.compile(r"[a-z_][a-z0-9_-]{0,31}")
EVERYTHING = Globs(["*"])
NOTHING = Globs()


MEMBERS = ("shell_user", "guard", "policy", "page", "buttons")
# The members of each level in `policy`: what a level has no member for, it can never do.
LEVEL_MEMBERS: Mapping[Level, tuple[str, ...]] = {
    "observe": ("subscribe",),
    "drive": ("subscribe", "publish", "call"),
    "manage": ("subscribe", "publish", "call", "serve"),
}
# Times in which a robot can stop before it matters, and over which it would not.
GUARD_TIMES_MS: Mapping[str, Bounds] = {
    "deadman_ms": Bounds(200, 2000),
    "max_age_ms": Bounds(200, 2000),
}
# No robot needs more; so small a limit as the lowest stands still.
GUARD_LIMITS: Mapping[str, Bounds] = {
    "max_speed_m_s": Bounds(0.001, 100),
    "max_turn_rad_s": Bounds(0.001, 100),
    "max_acceleration_m_s2": Bounds(0.001, 1000),
    "max_turn_acceleration_rad_s2": Bounds(0.001, 1000),
    "max_steering_rad": Bounds(0.001, 3.2),
}
CONNECTION_LIMITS: Mapping[str, Bounds] = {
    "subscriptions": Bounds(1, 10_000),
    "messages_per_s": Bounds(1, 100_000),
    "message_kb": Bounds(1, 10_240),
}


@dataclass(frozen=True)
class GuardSettings:
    """What the guard on the robot holds drive commands to; None: no limit."""

    drive_topics: Globs = field(default_factory=lambda: Globs(["/cmd_vel", "*/cmd_vel"]))
    deadman_ms: int = 500
    max_age_ms: int = 500
    max_speed_m_s: float | None = None
    max_turn_rad_s: float | None = None
    max_acceleration_m_s2: float | None = None
    max_turn_acceleration_rad_s2: float | None = None
    max_steering_rad: float | None = None

    def as_dict(self) -> dict[str, object]:
        """Return the JSON members, all of them, as they go to the agent."""
        return _members(self)


@dataclass(frozen=True)
class LevelPolicy:
    """What a connection of one level may name in its operations."""

    subscribe: Globs = EVERYTHING
    publish: Globs = NOTHING
    call: Globs = NOTHING
    serve: Globs = NOTHING
    # Whether the robot's drive topics belong to `publish`, whatever stands there.
    drives: bool = False


@dataclass(frozen=True)
class Limits:
    """How much one connection may ask for."""

    subscriptions: int = 100
    messages_per_s: int = 2000
    message_kb: int = 1024


@dataclass(frozen=True)
class Policy:
    """What connections to a robot may send, by their level."""

    observe: LevelPolicy = LevelPolicy()
    drive: LevelPolicy = LevelPolicy(drives=True)
    manage: LevelPolicy = LevelPolicy(
        publish=EVERYTHING, call=EVERYTHING, serve=EVERYTHING, drives=True
    )
    limits: Limits = Limits()

    def of(self, level: Level) -> LevelPolicy:
        """Return what a connection of this level may do."""
        policies: dict[Level, LevelPolicy] = {
            "observe": self.observe,
            "drive": self.drive,
            "manage": self.manage,
        }
        return policies[level]

    def as_dict(self) -> dict[str, object]:
        """Return the JSON members, all of them."""
        levels: dict[str, object] = {
            name: {member: list(getattr(getattr(self, name), member)) for member in members}
            for name, members in LEVEL_MEMBERS.items()
        }
        return {**levels, "limits": _members(self.limits)}


@dataclass(frozen=True)
class RobotSettings:
    """All settings of a robot."""

    shell_user: str | None = None
    guard: GuardSettings = GuardSettings()
    policy: Policy = Policy()
    page: PageSettings = page_settings.DEFAULTS
    buttons: tuple[Button, ...] = ()

    def as_dict(self) -> dict[str, object]:
        """Return all that is in force; `shell_user` is missing when there is none."""
        shell: dict[str, object] = (
            {} if self.shell_user is None else {"shell_user": self.shell_user}
        )
        return {
            **shell,
            "guard": self.guard.as_dict(),
            "policy": self.policy.as_dict(),
            "page": self.page.as_dict(),
            "buttons": [button.as_dict() for button in self.buttons],
        }

    def as_given(self) -> dict[str, object]:
        """Return what differs from the defaults: what is kept in the database."""
        return _difference(self.as_dict(), DEFAULTS.as_dict())


DEFAULTS = RobotSettings()


def parse(given: object) -> RobotSettings:
    """Return the settings that this JSON object means; raise FieldInvalid, which names the member."""
    members = setting_values.members(given, "settings", MEMBERS)
    user = shell_user(members["shell_user"]) if "shell_user" in members else None
    settings = RobotSettings(
        shell_user=user,
        guard=_guard(members.get("guard", {})),
        policy=_policy(members.get("policy", {})),
        page=page_settings.parse(members.get("page", {})),
        buttons=button_settings.parse(members.get("buttons", [])),
    )
    _check_drive_topic(settings)
    for button in settings.buttons:
        check_button(settings, button)
    return settings


def lacking(settings: RobotSettings, button: Button) -> str | None:
    """Return the path in the policy that keeps drivers from this button; None: nothing does."""
    right = button.kind
    drivers: Globs = getattr(settings.policy.drive, right)
    return None if drivers.match(button.target) else f"policy.drive.{right}"


def check_button(settings: RobotSettings, button: Button) -> None:
    """Raise FieldInvalid for a button that no driver may press, or that would move the robot past the controls."""
    if button.kind == "publish" and settings.guard.drive_topics.match(button.target):
        raise FieldInvalid(
            f"cannot use button {button.name!r}: {button.target} is a drive topic of this robot (guard.drive_topics), "
            "and those are for the page's own controls"
        )
    if (path := lacking(settings, button)) is not None:
        raise FieldInvalid(
            f"cannot use button {button.name!r}: the robot's policy does not let a driver {button.kind} "
            f"{button.target}; an admin adds it to {path}, or the button goes"
        )


def _check_drive_topic(settings: RobotSettings) -> None:
    topic = settings.page.drive_topic
    if topic is not None and not settings.guard.drive_topics.match(topic):
        # The guard would not watch over it: nothing would stop the robot when commands stop.
        raise FieldInvalid(
            f"cannot use page.drive_topic: {topic} is no drive topic of this robot; an admin adds it to "
            "guard.drive_topics"
        )


def shell_user(name: object) -> str:
    """Return a name that an account on a robot may have; raise FieldInvalid."""
    if not isinstance(name, str) or not SHELL_USER.fullmatch(name):
        raise FieldInvalid(
            "cannot use shell_user: it must be the name of an account on the robot, of at most 32 "
            "characters a-z, 0-9, _ and -"
        )
    return name


def _guard(given: object) -> GuardSettings:
    members = setting_values.members(
        given, "guard", [known.name for known in fields(GuardSettings)]
    )
    values: dict[str, Any] = {}
    for name, value in members.items():
        path = f"guard.{name}"
        if name == "drive_topics":
            values[name] = _drive_topics(value, path)
        elif name in GUARD_TIMES_MS:
            values[name] = setting_values.whole(value, path, GUARD_TIMES_MS[name])
        elif value is not None:
            values[name] = setting_values.number(
                value, path, GUARD_LIMITS[name], "null, for no limit, or "
            )
    return GuardSettings(**values)


def _policy(given: object) -> Policy:
    members = setting_values.members(given, "policy", (*LEVEL_MEMBERS, "limits"))
    values: dict[str, Any] = {
        level: _level(members[level], level) for level in LEVEL_MEMBERS if level in members
    }
    if "limits" in members:
        values["limits"] = _limits(members["limits"])
    return Policy(**values)


def _level(given: object, level: Level) -> LevelPolicy:
    path = f"policy.{level}"
    members = setting_values.members(given, path, LEVEL_MEMBERS[level])
    present = DEFAULTS.policy.of(level)
    values = {
        name: setting_values.globs(members[name], f"{path}.{name}")
        if name in members
        else getattr(present, name)
        for name in ("subscribe", "publish", "call", "serve")
    }
    return LevelPolicy(**values, drives=present.drives)


def _limits(given: object) -> Limits:
    members = setting_values.members(given, "policy.limits", CONNECTION_LIMITS)
    bounds = CONNECTION_LIMITS
    values = {
        name: setting_values.whole(value, f"policy.limits.{name}", bounds[name])
        for name, value in members.items()
    }
    return Limits(**values)


def _drive_topics(given: object, path: str) -> Globs:
    globs = setting_values.globs(given, path)
    if not globs.patterns:
        # Without one, every command would pass the guard unseen.
        raise FieldInvalid(f"cannot use {path}: it must name at least one topic")
    return globs


def _members(of: GuardSettings | Limits) -> dict[str, object]:
    values = {known.name: getattr(of, known.name) for known in fields(of)}
    return {k: list(v) if isinstance(v, Globs) else v for k, v in values.items()}


def _difference(present: Mapping[str, object], default: Mapping[str, object]) -> dict[str, object]:
    """Return the members that differ, and of objects what differs in them."""
    differs: dict[str, object] = {}
    for name, value in present.items():
        usual = default.get(name)
        if isinstance(value, Mapping) and isinstance(usual, Mapping):
            if inner := _difference(value, usual):
                differs[name] = inner
        elif value != usual:
            differs[name] = value
    return differs


Settings = dict[str, object]


def get_path(settings: Mapping[str, object], path: str) -> object:
    """Return what stands at a path; None where nothing does."""
    found: object = settings
    for step in path.split("."):
        found = found.get(step) if isinstance(found, Mapping) else None
    return found


def is_in(settings: Mapping[str, object], path: str) -> bool:
    """Tell whether something stands there, be it null."""
    folder, dot, last = path.rpartition(".")
    found = get_path(settings, folder) if dot else settings
    return isinstance(found, Mapping) and last in found


def put_path(settings: Mapping[str, object], path: str, value: object) -> Settings:
    """Return settings in which the value stands there, in place of what stood there or in its way."""
    first, dot, rest = path.partition(".")
    return {**settings, first: put_path(_inner(settings, first), rest, value) if dot else value}


def remove_path(settings: Mapping[str, object], path: str) -> Settings:
    """Return settings in which nothing stands there."""
    first, dot, rest = path.partition(".")
    if not is_in(settings, path):
        return dict(settings)
    if dot:
        return {**settings, first: remove_path(_inner(settings, first), rest)}
    return {name: value for name, value in settings.items() if name != first}


def _inner(settings: Mapping[str, object], name: str) -> Mapping[str, object]:
    found = settings.get(name)
    return found if isinstance(found, Mapping) else {}
