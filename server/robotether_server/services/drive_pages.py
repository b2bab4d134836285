"""Sets a robot's drive page for its managers: kind, cameras, video and buttons.

The rest of its settings are admins' (robots.py). The caller has checked that the user manages the
robot, and for `allow` that it is an admin. Connections stay; a page applies a change when it is opened next.
"""

import json
from collections.abc import Callable
from typing import Literal

from robotether_server.db import Transaction, audit, robots
from robotether_server.db.audit import Source
from robotether_server.problems import FieldInvalidError, NotPossibleError
from robotether_server.services import robots as robot_service
from robotether_server.settings import buttons as button_settings
from robotether_server.settings import robot as robot_settings
from robotether_server.settings.buttons import Button
from robotether_server.settings.robot import RobotSettings, Settings, put_path, same_json

# All settings before a change, to those after it; and the same of the buttons.
SettingsChange = Callable[[Settings], Settings]
Change = Callable[[list[Button]], list[Button]]


def set_page(tx: Transaction, source: Source, name: str, page: object) -> RobotSettings:
    """Replace `page`; what is missing is as by default. Raises FieldInvalidError. Returns all that is in force then."""
    return _set(tx, source, name, "page", page)


def change_page(
    tx: Transaction, source: Source, name: str, change: SettingsChange
) -> RobotSettings:
    """Replace `page` by that of the settings that `change` makes of the present ones; raise FieldInvalidError.

    No other change comes in between.
    """
    robots.lock_enrolment(tx)
    return set_page(tx, source, name, change(robots.get(tx, name).settings).get("page", {}))


def set_buttons(tx: Transaction, source: Source, name: str, buttons: object) -> RobotSettings:
    """Replace `buttons`; raise FieldInvalidError. Returns all that is in force then."""
    return _set(tx, source, name, "buttons", buttons)


def change_buttons(tx: Transaction, source: Source, name: str, change: Change) -> RobotSettings:
    """Replace `buttons` by the result of `change`; no other change comes in between."""
    robots.lock_enrolment(tx)
    present = button_settings.parse(robots.get(tx, name).settings.get("buttons", []))
    changed = [button.as_dict() for button in change(list(present))]
    return set_buttons(tx, source, name, changed)


def allow(tx: Transaction, source: Source, name: str, button: Button) -> None:
    """Add what the button sends to the drivers' policy, if it is missing; raise FieldInvalidError."""

    def change(present: Settings) -> Settings:
        settings = robot_settings.parse(present)
        path = robot_settings.lacking(settings, button)
        if path is None:
            return present
        names = getattr(settings.policy.drive, button.kind)
        return put_path(present, path, [*names, button.target])

    robot_service.change_settings(tx, source, name, change)


def index_of(buttons: list[Button], place: int, name: str) -> int:
    """Return the index of the button at this place, from 1; raise NotPossibleError if its name has changed."""
    if not 1 <= place <= len(buttons) or buttons[place - 1].name != name:
        raise NotPossibleError(
            f"cannot change button {name}: the buttons have changed meanwhile; check them again"
        )
    return place - 1


def read(text: str) -> dict[str, object]:
    """Parse a JSON object from a form; raise FieldInvalidError, which names the place of the error."""
    try:
        members = json.loads(text or "{}", object_pairs_hook=_once)
    except json.JSONDecodeError as error:
        raise FieldInvalidError(
            f"cannot read what the button sends: {error.msg} at line {error.lineno}, column {error.colno}; it must "
            'be a JSON object such as {"data": true}',
            "sends",
        ) from error
    except (ValueError, RecursionError) as error:
        raise FieldInvalidError(f"cannot read what the button sends: {error}", "sends") from error
    if not isinstance(members, dict):
        raise FieldInvalidError(
            'cannot read what the button sends: it must be a JSON object such as {"data": true}',
            "sends",
        )
    return members


def _once(pairs: list[tuple[str, object]]) -> dict[str, object]:
    members = dict(pairs)
    if len(members) != len(pairs):
        raise ValueError("a member appears twice")
    return members


def _set(
    tx: Transaction, source: Source, name: str, member: Literal["page", "buttons"], value: object
) -> RobotSettings:
    robots.lock_enrolment(tx)
    robot = robots.get(tx, name)
    settings = robot_settings.parse({**robot.settings, member: value})
    values, was = settings.as_given(), robot.settings.get(member)
    if not same_json(values.get(member), was):
        robots.set_settings(tx, robot.id, values)
        changed = {"was": was, member: values.get(member)}
        audit.record(tx, source, f"robot_{member}_set", name, **changed)
    return settings
