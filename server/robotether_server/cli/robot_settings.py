"""robotether robot settings, set: a robot's policy, its guard's limits and the account of its shell.

docs/reference/robot-settings.md has what no form says. Relay and guard follow a change by themselves.
"""

import json
from collections.abc import Sequence

import click

from robotether_server.cli.common import SOURCE, NotDoneError, open_database, print_json
from robotether_server.db import seen_robots
from robotether_server.problems import FieldInvalidError
from robotether_server.services import robots
from robotether_server.settings import robot as robot_settings
from robotether_server.settings.robot import Settings, get_path, is_in, put_path, remove_path

SHELL_USER = "shell_user"
# What is missing in the settings in force when there is none.
OPTIONAL = (SHELL_USER, "region")
# Where null is a value of its own, and not the default.
MEANT_NULLS = ("page.hold_after_ms",)

# A path such as guard.deadman_ms, and its new value; None: its default.
Change = tuple[str, object]


@click.command("settings")
@click.argument("name")
def show_settings(name: str) -> None:
    """Print the settings that are in force at a robot.

    All of them as JSON, the defaults included. To change them: set.
    """
    with open_database().transaction() as tx:
        present = seen_robots.get_seen(tx, name).robot.settings
    try:
        in_force = robot_settings.parse(present).as_dict()
    except FieldInvalidError as problem:
        raise NotDoneError(
            f"cannot show the settings of robot {name}; it is locked until they are corrected with "
            f"robot set: {problem.detail}"
        ) from problem
    print_json(in_force)


@click.command("set")
@click.argument("name")
@click.argument("changes", nargs=-1, metavar="[KEY=VALUE]...")
@click.option(
    "--shell-user",
    metavar="ACCOUNT",
    help="Account on the robot that ssh logs in to; '' for everybody's own user name.",
)
def set_settings(name: str, changes: Sequence[str], shell_user: str | None) -> None:
    """Change a robot's settings, all given ones or none.

    A KEY is a path in the output of robot settings, a VALUE is JSON or else a plain text. null restores the default,
    except that page.hold_after_ms=null never pauses driving because of old video.

    robotether robot set sim1 guard.max_speed_m_s=0.5 guard.deadman_ms=400

    robotether robot set sim1 'guard.drive_topics=["/cmd_vel"]' guard.max_speed_m_s=null

    A change is in force at once. A change of drive topics, max_age_ms or policy disconnects operators, who
    connect again.
    """
    requests = [_change(name, text) for text in changes]
    if shell_user is not None:
        requests.append((SHELL_USER, shell_user or None))
    if not requests:
        raise NotDoneError(f"cannot change robot {name}: say what; see --help")
    _check_said_once([path for path, _ in requests])
    with open_database().transaction() as tx:
        changed = robots.change_settings(
            tx, SOURCE, name, lambda present: _changed(present, requests)
        )
    in_force = changed.as_dict()
    now = " ".join(f"{path}={json.dumps(get_path(in_force, path))}" for path, _ in requests)
    click.echo(f"robot {name} has {now}")


def _change(name: str, text: str) -> Change:
    path, equals, value = text.partition("=")
    if not equals:
        raise NotDoneError(
            f"cannot set {text!r} of robot {name}: write KEY=VALUE, such as guard.deadman_ms=400"
        )
    return path, _value(value)


def _value(text: str) -> object:
    """Return the text parsed as JSON, or else the text itself; the settings check the value."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text


def _check_said_once(paths: Sequence[str]) -> None:
    for path in paths:
        if paths.count(path) > 1:
            raise FieldInvalidError(f"cannot use {path}: it is given twice")


def _changed(present: Settings, requests: Sequence[Change]) -> Settings:
    """Return the settings with the changes, unchecked; raise FieldInvalidError for a default of no setting."""
    settings = present
    for path, value in requests:
        if value is None and path not in MEANT_NULLS:
            _check_known(present, path)
            settings = remove_path(settings, path)
        else:
            settings = put_path(settings, path, value)
    return settings


def _check_known(present: Settings, path: str) -> None:
    # A typing error in the name of a limit must not pass for the end of that limit.
    defaults = robot_settings.DEFAULTS.as_dict()
    if path not in OPTIONAL and not is_in(defaults, path) and not is_in(present, path):
        raise FieldInvalidError(f"cannot use {path}: it is not a setting; see: robot settings")
