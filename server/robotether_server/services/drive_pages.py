"""Changes the buttons of a robot's drive page for its managers.

The rest of its settings are admins' (robots.py). The caller has checked that the user manages the
robot, and for `allow` that it is an admin. Connections stay; a page applies a change when it is opened next.
"""

import json
from collections.abc import Callable

from robotether_server.db import Transaction
from robotether_server.db.audit import Source
from robotether_server.problems import FieldInvalidError, NotPossibleError
from robotether_server.services import robots as robot_service
from robotether_server.settings import buttons as button_settings
from robotether_server.settings import robot as robot_settings
from robotether_server.settings.buttons import Button
from robotether_server.settings.robot import Settings, put_path

# The buttons before a change, to those after it.
Change = Callable[[list[Button]], list[Button]]


def change_buttons(tx: Transaction, source: Source, name: str, change: Change) -> None:
    """Replace `buttons` by the result of `change`; no other change comes in between. Raises FieldInvalidError."""

    def changed(present: Settings) -> Settings:
        buttons = button_settings.parse(present.get("buttons", []))
        return {**present, "buttons": [button.as_dict() for button in change(list(buttons))]}

    robot_service.change_settings(tx, source, name, changed, "buttons")


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
