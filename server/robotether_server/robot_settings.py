"""A robot's settings: the shell's account, what its guard does, and who may send what.

Kept in `robots.settings` as JSON that names only what differs from the defaults. Web and command
line check with `parse` what an admin gives; the relay reads the same JSON and sends `guard` on to
the robot. docs/protocols.md describes every member. Must never take a member that it does not
know, or a number without bounds: a limit with a typing error would be no limit. Pure.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal, NamedTuple

from robotether_server.globs import LONGEST_GLOB, Globs, is_glob
from robotether_server.problems import FieldInvalid

Level = Literal["observe", "drive", "manage"]

SHELL_USER = re.compile(r"[a-z_][a-z0-9_-]{0,31}")
MOST_GLOBS = 64
EVERYTHING = Globs(["*"])
NOTHING = Globs()


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

    def as_dict(self) -> dict[str, object]:
        """Return all that is in force; `shell_user` is missing when there is none."""
        shell: dict[str, object] = (
            {} if self.shell_user is None else {"shell_user": self.shell_user}
        )
        return {**shell, "guard": self.guard.as_dict(), "policy": self.policy.as_dict()}

    def as_given(self) -> dict[str, object]:
        """Return what differs from the defaults: what is kept in the database."""
        return _difference(self.as_dict(), DEFAULTS.as_dict())


DEFAULTS = RobotSettings()

# The members of each level in `policy`: what a level has no member for, it can never do.
LEVEL_MEMBERS: Mapping[Level, tuple[str, ...]] = {
    "observe": ("subscribe",),
    "drive": ("subscribe", "publish", "call"),
    "manage": ("subscribe", "publish", "call", "serve"),
}


class Bounds(NamedTuple):
    """The lowest and the highest value that a number may have."""

    low: float
    high: float


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


def parse(given: object) -> RobotSettings:
    """Return the settings that this JSON object means; raise FieldInvalid, which names the member."""
    members = _object(given, "settings", ("shell_user", "guard", "policy"))
    user = shell_user(members["shell_user"]) if "shell_user" in members else None
    return RobotSettings(
        shell_user=user,
        guard=_guard(members.get("guard", {})),
        policy=_policy(members.get("policy", {})),
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
    members = _object(given, "guard", [known.name for known in fields(GuardSettings)])
    values: dict[str, Any] = {}
    for name, value in members.items():
        path = f"guard.{name}"
        if name == "drive_topics":
            values[name] = _drive_topics(value, path)
        elif name in GUARD_TIMES_MS:
            values[name] = _whole(value, path, GUARD_TIMES_MS[name])
        elif value is not None:
            values[name] = _number(value, path, GUARD_LIMITS[name])
    return GuardSettings(**values)


def _policy(given: object) -> Policy:
    members = _object(given, "policy", (*LEVEL_MEMBERS, "limits"))
    values: dict[str, Any] = {
        level: _level(members[level], level) for level in LEVEL_MEMBERS if level in members
    }
    if "limits" in members:
        values["limits"] = _limits(members["limits"])
    return Policy(**values)


def _level(given: object, level: Level) -> LevelPolicy:
    path = f"policy.{level}"
    members = _object(given, path, LEVEL_MEMBERS[level])
    present = DEFAULTS.policy.of(level)
    values = {
        name: _globs(members[name], f"{path}.{name}") if name in members else getattr(present, name)
        for name in ("subscribe", "publish", "call", "serve")
    }
    return LevelPolicy(**values, drives=present.drives)


def _limits(given: object) -> Limits:
    members = _object(given, "policy.limits", CONNECTION_LIMITS)
    bounds = CONNECTION_LIMITS
    values = {
        name: _whole(value, f"policy.limits.{name}", bounds[name])
        for name, value in members.items()
    }
    return Limits(**values)


def _object(
    given: object, path: str, known: tuple[str, ...] | list[str] | Mapping[str, object]
) -> Mapping[str, object]:
    if not isinstance(given, Mapping):
        raise FieldInvalid(f"cannot use {path}: it must be an object with members")
    for name in given:
        if name not in known:
            raise FieldInvalid(
                f"cannot use {path}: {str(name)[:40]!r} is no setting; there is {', '.join(known)}"
            )
    return given


def _drive_topics(given: object, path: str) -> Globs:
    globs = _globs(given, path)
    if not globs.patterns:
        # Without one, every command would pass the guard unseen.
        raise FieldInvalid(f"cannot use {path}: it must name at least one topic")
    return globs


def _globs(given: object, path: str) -> Globs:
    if not isinstance(given, list | tuple) or len(given) > MOST_GLOBS:
        raise FieldInvalid(f"cannot use {path}: it must be a list of at most {MOST_GLOBS} names")
    for pattern in given:
        if not isinstance(pattern, str) or not is_glob(pattern):
            raise FieldInvalid(
                f"cannot use {path}: {str(pattern)[:40]!r} is no full name, such as /arm/move or */cmd_vel; a "
                f"name begins with / or *, has a-z, A-Z, 0-9, _, / and * and at most {LONGEST_GLOB} characters"
            )
    return Globs(dict.fromkeys(given))


def _whole(given: object, path: str, bounds: Bounds) -> int:
    value = _plain_number(given)
    if value is None or value != math.floor(value) or not bounds.low <= value <= bounds.high:
        raise FieldInvalid(
            f"cannot use {path}: it must be a whole number from {bounds.low:g} to {bounds.high:g}"
        )
    return int(value)


def _number(given: object, path: str, bounds: Bounds) -> float:
    value = _plain_number(given)
    if value is None or not bounds.low <= value <= bounds.high:
        raise FieldInvalid(
            f"cannot use {path}: it must be null, for no limit, or a number from {bounds.low:g} to {bounds.high:g}"
        )
    return float(value)


def _plain_number(given: object) -> int | float | None:
    # True and False are numbers to Python, and not to JSON; so are NaN and infinity.
    if isinstance(given, bool) or not isinstance(given, int | float):
        return None
    return given if isinstance(given, int) or math.isfinite(given) else None


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
