"""A robot's settings: shell account, region, guard, who may send what, what its page shows, when it asks for help.

Kept in `robots.settings` as JSON that names only what differs from the defaults. Web and command
line check with `parse` what people give; the relay reads the same JSON and sends `guard` on to
the robot. docs/reference/robot-settings.md has what no form says. Must never take a member that it does not
know, or a number without bounds: a limit with a typing error would be no limit. The page's form and the command
line name members by paths such as guard.deadman_ms (`get_path`, `put_path`). Pure: what is given is never changed.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Annotated, Literal

from msgspec import UNSET, Meta, Struct, UnsetType, field, structs
from robotether_common.guard import DEFAULT_MS, DEFAULT_TOPICS, TIMES_MS
from robotether_common.ros import Globs

from robotether_server import schemas
from robotether_server.problems import FieldInvalidError
from robotether_server.schemas import GLOBS_SCHEMA, GivenGlobs, Level, setting
from robotether_server.settings import buttons as button_settings
from robotether_server.settings import help as help_settings
from robotether_server.settings import page as page_settings
from robotether_server.settings.buttons import Button, GivenButtons
from robotether_server.settings.help import HelpSettings
from robotether_server.settings.page import PageSettings, Speed

SHELL_USER_PATTERN = "^[a-z_][a-z0-9_-]*$"
MAX_SHELL_USER_LENGTH = 32
EVERYTHING = Globs(["*"])
NOTHING = Globs()


def _drive_topics(raw: object, path: str) -> Globs:
    globs = schemas.read_globs(raw, path)
    if not globs.patterns:
        # Without one, every command would pass the guard unseen.
        raise FieldInvalidError(f"cannot use {path}: it must name at least one topic", path)
    return globs


ShellUser = Annotated[
    str,
    Meta(
        min_length=1,
        max_length=MAX_SHELL_USER_LENGTH,
        pattern=SHELL_USER_PATTERN,
        description="The account on the robot that a shell logs in to",
        extra={
            "exact": True,
            "must": "the name of an account on the robot, of at most 32 characters a-z, 0-9, _ and -",
        },
    ),
]
Region = Annotated[
    str,
    Meta(
        min_length=1,
        max_length=63,
        pattern="^[a-z0-9-]+$",
        description="The region of the robot, whose machines it connects to first",
        extra={"exact": True, "must": "1 to 63 of a-z, 0-9 and -"},
    ),
]
DriveTopics = Annotated[
    Globs,
    Meta(extra_json_schema=GLOBS_SCHEMA | {"minItems": 1}, extra={"read": _drive_topics}),
    setting(
        "Drive topics",
        "Topics that move the robot: Twist, TwistStamped or AckermannDriveStamped.",
        typed="Full names, one a line; * stands for any text.",
    ),
]
GuardTime = Annotated[int, Meta(ge=TIMES_MS[0], le=TIMES_MS[1])]
Acceleration = Annotated[float, Meta(ge=0.001, le=1000)]
Angle = Annotated[float, Meta(ge=0.001, le=3.2)]
BlindLength = Annotated[float, Meta(ge=0.01, le=100)]
BlindAngle = Annotated[float, Meta(ge=1, le=3600)]
CameraTime = Annotated[int, Meta(ge=0, le=2000)]
WithoutFrames = Literal["unlimited", "slowest"]
RecordingWhen = Literal["never", "driven", "on_stop", "always"]
Publish = Annotated[GivenGlobs, setting("Publish to", "Topics in addition to the drive topics.")]
Call = Annotated[
    GivenGlobs, setting("Call", "Services and actions, in addition to the look-ups of /rosapi.")
]


def _limit(title: str, description: str, unit: str, **extra: str) -> Meta:
    return setting(title, description, unit=unit, empty="no limit", **extra)


class GuardSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The limits of the guard on the robot for drive commands; null: no limit."""

    drive_topics: DriveTopics = field(default_factory=lambda: Globs(DEFAULT_TOPICS))
    deadman_ms: Annotated[
        GuardTime,
        setting(
            "Stop if no command arrives for",
            "Counted from the last command that moves the robot.",
            unit="ms",
        ),
    ] = DEFAULT_MS
    max_age_ms: Annotated[
        GuardTime,
        setting(
            "Ignore commands older than",
            "Their age is checked when they arrive. A change stops the robot and disconnects everyone.",
            unit="ms",
        ),
    ] = DEFAULT_MS
    max_speed_m_s: Annotated[
        Speed | None,
        _limit(
            "Robot's limit",
            "Faster commands are reduced to it.",
            "m/s",
            beside="page.max_speed_m_s",
        ),
    ] = None
    max_turn_rad_s: Annotated[
        Speed | None,
        _limit(
            "Robot's turn limit",
            "Faster turns are reduced to it.",
            "°/s",
            beside="page.max_turn_rad_s",
        ),
    ] = None
    max_acceleration_m_s2: Annotated[
        Acceleration | None,
        _limit(
            "Top acceleration",
            "Limited only while the speed grows; braking is never delayed.",
            "m/s²",
        ),
    ] = None
    max_turn_acceleration_rad_s2: Annotated[
        Acceleration | None,
        _limit("Top turn acceleration", "Limited only while the turn grows.", "°/s²"),
    ] = None
    max_steering_rad: Annotated[
        Angle | None, _limit("Maximum steering angle", "For robots that steer like a car.", "°")
    ] = None
    blind_m: Annotated[
        BlindLength | None,
        _limit(
            "Distance driven unseen",
            "The older what the driver sees, the slower the robot: speed times age stays within this.",
            "m",
            box="Drive slower when the driver sees late",
        ),
    ] = 0.25
    blind_deg: Annotated[
        BlindAngle | None,
        _limit(
            "Angle turned unseen",
            "The same for turns.",
            "degrees",
            box="Turn slower when the driver sees late",
        ),
    ] = 30
    camera_ms: Annotated[
        CameraTime,
        setting(
            "Delay of the camera",
            "Until its frames have a timestamp; it is added to the age of what the driver sees.",
            unit="ms",
        ),
    ] = 0
    without_frames: Annotated[
        WithoutFrames,
        setting(
            "Programs that do not say what their driver sees",
            options={"unlimited": "Drive without this limit", "slowest": "Have the slowest speed"},
        ),
    ] = "unlimited"

    def as_dict(self) -> dict[str, object]:
        """Return the JSON members, all of them, as they go to the agent."""
        return {**structs.asdict(self), "drive_topics": list(self.drive_topics)}


class LevelPolicy(Struct, frozen=True):
    """The names that a connection of one level may use, by kind of operation."""

    subscribe: Globs = EVERYTHING
    publish: Globs = NOTHING
    call: Globs = NOTHING
    serve: Globs = NOTHING
    # Whether `publish` always includes the robot's drive topics.
    drives: bool = False


class Limits(Struct, frozen=True, forbid_unknown_fields=True):
    """Limits of one connection."""

    subscriptions: Annotated[int, Meta(ge=1, le=10_000), setting("Subscriptions")] = 100
    messages_per_s: Annotated[int, Meta(ge=1, le=100_000), setting("Messages a second")] = 2000
    message_kb: Annotated[int, Meta(ge=1, le=10_240), setting("Largest message", unit="KB")] = 1024


class ObserveNames(Struct, frozen=True, forbid_unknown_fields=True):
    """The names that observers may use. A level can never do what it has no member for."""

    subscribe: Annotated[
        GivenGlobs, setting("Subscribe to", "Topics that they may subscribe to.")
    ] = field(default_factory=lambda: EVERYTHING)


class DriveNames(ObserveNames, frozen=True):
    """The names that drivers may use, beside the drive topics."""

    publish: Publish = field(default_factory=lambda: NOTHING)
    call: Call = field(default_factory=lambda: NOTHING)


class ManageNames(ObserveNames, frozen=True):
    """The names that managers may use, beside the drive topics."""

    publish: Publish = field(default_factory=lambda: EVERYTHING)
    call: Call = field(default_factory=lambda: EVERYTHING)
    serve: Annotated[
        GivenGlobs, setting("Serve", "Services and actions that they may offer to the robot.")
    ] = field(default_factory=lambda: EVERYTHING)


class GivenPolicy(Struct, frozen=True, forbid_unknown_fields=True):
    """What connections to a robot may send, by level."""

    observe: ObserveNames = field(default_factory=ObserveNames)
    drive: DriveNames = field(default_factory=DriveNames)
    manage: ManageNames = field(default_factory=ManageNames)
    limits: Limits = Limits()


# The members of each level in `policy`.
LEVEL_MEMBERS: Mapping[Level, tuple[str, ...]] = {
    "observe": ObserveNames.__struct_fields__,
    "drive": DriveNames.__struct_fields__,
    "manage": ManageNames.__struct_fields__,
}


class Policy(Struct, frozen=True):
    """What connections to a robot may send, by level."""

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
        return {**levels, "limits": structs.asdict(self.limits)}


class RecordingSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """When the robot is recorded without anybody asking for it."""

    when: Annotated[
        RecordingWhen,
        setting(
            "Record",
            "What the robot sends and what its driver does, into a file. The drive page shows that it is recorded.",
            options={
                "never": "never, unless a driver asks",
                "driven": "while somebody drives",
                "on_stop": "30 s before and after a stop",
                "always": "always",
            },
        ),
    ] = "never"


class RobotSettings(Struct, frozen=True):
    """All settings of a robot."""

    shell_user: str | None = None
    region: str | None = None
    guard: GuardSettings = GuardSettings()
    policy: Policy = Policy()
    page: PageSettings = page_settings.DEFAULTS
    recording: RecordingSettings = RecordingSettings()
    buttons: tuple[Button, ...] = ()
    help: HelpSettings = help_settings.DEFAULTS

    def as_dict(self) -> dict[str, object]:
        """Return all that is in force; `shell_user` and `region` are missing when there is none."""
        names: dict[str, object] = {"shell_user": self.shell_user, "region": self.region}
        return {
            **{name: value for name, value in names.items() if value is not None},
            "guard": self.guard.as_dict(),
            "policy": self.policy.as_dict(),
            "page": self.page.as_dict(),
            "recording": structs.asdict(self.recording),
            "buttons": [button.as_dict() for button in self.buttons],
            "help": self.help.as_dict(),
        }

    @property
    def drive_topic(self) -> str:
        """Where the page drives; empty: the guard has only patterns."""
        allowed = self.guard.drive_topics
        usual = DEFAULT_TOPICS[0] if allowed.match(DEFAULT_TOPICS[0]) else ""
        named = (topic for topic in allowed if "*" not in topic)
        return self.page.drive_topic or next(named, usual)

    @property
    def battery(self) -> dict[str, object]:
        """What the agent needs to find and read the battery, as JSON members."""
        page = self.page
        return {
            "topic": page.battery_topic,
            "unit": page.battery_unit,
            "drive_topic": self.drive_topic,
        }

    @property
    def help_rules(self) -> dict[str, object]:
        """What the agent needs to ask for help, as JSON members."""
        settings, page = self.help, self.page
        return {
            "topic": settings.topic,
            "stopped": settings.stopped == "on",
            "battery_below": settings.battery_below,
            "diagnostics": settings.diagnostics == "on",
            "diagnostics_topic": page.diagnostics_topic,
            "geofence": settings.geofence,
            "pose_topic": settings.pose_topic or page.odometry_topic,
            "navigation_topic": settings.navigation_topic,
            "navigation_silent_s": settings.navigation_silent_s,
        }

    def as_given(self) -> dict[str, object]:
        """Return what differs from the defaults: what is kept in the database."""
        return _difference(self.as_dict(), DEFAULTS.as_dict())


DEFAULTS = RobotSettings()


class GivenSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """A robot's settings; what is not given has its default."""

    shell_user: ShellUser | UnsetType = UNSET
    region: Region | UnsetType = UNSET
    guard: GuardSettings = field(default_factory=GuardSettings)
    policy: GivenPolicy = field(default_factory=GivenPolicy)
    page: PageSettings = page_settings.DEFAULTS
    recording: RecordingSettings = RecordingSettings()
    buttons: GivenButtons = []
    help: HelpSettings = help_settings.DEFAULTS


def parse(raw: object) -> RobotSettings:
    """Return the settings that this JSON object means; raise FieldInvalidError, which names the member."""
    if not isinstance(raw, Mapping):
        raise FieldInvalidError("cannot use settings: it must be a JSON object")
    members = schemas.read(raw, GivenSettings, of="settings")
    policy = members.policy
    settings = RobotSettings(
        shell_user=members.shell_user or None,
        region=members.region or None,
        guard=members.guard,
        policy=Policy(
            observe=LevelPolicy(**structs.asdict(policy.observe)),
            drive=LevelPolicy(**structs.asdict(policy.drive), drives=True),
            manage=LevelPolicy(**structs.asdict(policy.manage), drives=True),
            limits=policy.limits,
        ),
        page=page_settings.check(members.page),
        recording=members.recording,
        buttons=button_settings.made(members.buttons),
        help=help_settings.check(members.help),
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
    """Raise FieldInvalidError for a button that no driver may press, or that would move the robot past the controls."""
    if button.kind == "publish" and settings.guard.drive_topics.match(button.target):
        raise FieldInvalidError(
            f"cannot use button {button.name!r}: {button.target} is a drive topic of this robot (guard.drive_topics), "
            "and those are for the page's own controls",
            "button.target",
        )
    if (path := lacking(settings, button)) is not None:
        raise FieldInvalidError(
            f"cannot use button {button.name!r}: the robot's policy does not let a driver {button.kind} "
            f"{button.target}; an admin adds it to {path}, or the button goes",
            "button.target",
        )


def _check_drive_topic(settings: RobotSettings) -> None:
    topic = settings.page.drive_topic
    if topic is not None and not settings.guard.drive_topics.match(topic):
        # The guard would not watch over it: nothing would stop the robot when commands stop.
        raise FieldInvalidError(
            f"cannot use page.drive_topic: {topic} is not a drive topic of this robot; an admin adds it to "
            "guard.drive_topics",
            "page.drive_topic",
        )


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


def same_json(value: object, other: object) -> bool:
    """Return whether two values are the same JSON. As texts: to Python, true is 1."""
    return json.dumps(value, sort_keys=True) == json.dumps(other, sort_keys=True)


Settings = dict[str, object]


def get_path(settings: Mapping[str, object], path: str) -> object:
    """Return the value at a path; None where there is none."""
    value: object = settings
    for step in path.split("."):
        value = value.get(step) if isinstance(value, Mapping) else None
    return value


def is_in(settings: Mapping[str, object], path: str) -> bool:
    """Return whether there is a value at a path, null included."""
    folder, dot, last = path.rpartition(".")
    inner = get_path(settings, folder) if dot else settings
    return isinstance(inner, Mapping) and last in inner


def put_path(settings: Mapping[str, object], path: str, value: object) -> Settings:
    """Return settings with the value at the path, replacing what is there or in its way."""
    first, dot, rest = path.partition(".")
    return {**settings, first: put_path(_inner(settings, first), rest, value) if dot else value}


def remove_path(settings: Mapping[str, object], path: str) -> Settings:
    """Return settings without a value at the path."""
    first, dot, rest = path.partition(".")
    if not is_in(settings, path):
        return dict(settings)
    if dot:
        return {**settings, first: remove_path(_inner(settings, first), rest)}
    return {name: value for name, value in settings.items() if name != first}


def _inner(settings: Mapping[str, object], name: str) -> Mapping[str, object]:
    value = settings.get(name)
    return value if isinstance(value, Mapping) else {}
