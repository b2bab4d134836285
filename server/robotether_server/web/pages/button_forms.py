"""/robots/NAME/settings/buttons: a robot's buttons, and the forms to add, change, remove and order them."""

import json
from collections.abc import Callable

from flask import Blueprint, render_template, request
from robotether_common import ros

from robotether_server import schemas
from robotether_server.api.context import context
from robotether_server.db import Transaction, seen_robots
from robotether_server.db.audit import Source
from robotether_server.db.robots import RobotRow
from robotether_server.problems import FieldInvalidError, NotPossibleError, RobotetherError
from robotether_server.services import drive_pages
from robotether_server.settings import buttons
from robotether_server.settings import robot as robot_settings
from robotether_server.settings.buttons import (
    MAX_FIELDS_BYTES,
    MAX_NAME_LENGTH,
    MEMBERS,
    Button,
    PublishButton,
)
from robotether_server.web import confirmation, current_user, forms
from robotether_server.web.confirmation import ConfirmedAction, Words
from robotether_server.web.forms import Saved, form
from robotether_server.web.pages.robot_settings import path_of, tabs_of
from robotether_server.web.pages.setting_fields import BUTTONS

blueprint = Blueprint("button_forms", __name__, url_prefix="/robots/<name>/settings/buttons")
blueprint.before_request(current_user.require_user)

KINDS = (("publish", "Publish a message"), ("call", "Call a service"))
MAX_TYPE_LENGTH = 140
# What refusals of settings call the form's fields.
FORM_NAMES = {
    "button.name": "name",
    "button.type": "type",
    "button.target": "target",
    "button.topic": "target",
    "button.service": "target",
    "button.msg": "sends",
    "button.args": "sends",
}
# Those of a button that calls are the same.
WORDS = schemas.words(PublishButton)
EMPTY = {"name": "", "kind": "publish", "target": "", "type": "", "sends": "{}", "confirm": ""}


@blueprint.get("")
def show_all(name: str, problem: RobotetherError | None = None) -> str:
    """Show the buttons in their order."""
    robot = _robot(name)
    present: tuple[Button, ...] = ()
    try:
        present = robot_settings.parse(robot.settings).buttons
    except FieldInvalidError as error:
        # Somebody wrote by SQL what nobody may set.
        problem = error
    return render_template(
        "settings/buttons.html",
        name=name,
        tab=BUTTONS,
        tabs_of_user=tabs_of(name),
        buttons=present,
        meant=forms.meant_mac(robot.mac),
        problem=problem,
    )


def show_new(name: str, problem: RobotetherError | None = None) -> str:
    """Show the empty form."""
    robot = _robot(name)
    _present(robot)
    return _page(robot, f"Add a button to robot {name}", EMPTY, problem=problem)


@form(blueprint, "/new", show_new)
def add(tx: Transaction, source: Source, name: str) -> Saved:
    """Add a button behind the others."""
    return _save(tx, source, name, lambda present, new: [*present, new])


def show(name: str, place: int, problem: RobotetherError | None = None) -> str:
    """Show the form of a button at its position."""
    robot = _robot(name)
    button = _at(robot, place)
    title = f"Button {button.name} of robot {name}"
    return _page(robot, title, _values(button), _was(button), problem)


@form(blueprint, "/<int:place>", show)
def change(tx: Transaction, source: Source, name: str, place: int) -> Saved:
    """Change a button at its position."""
    was = request.form.get("was", "")

    def put(present: list[Button], new: Button) -> list[Button]:
        present[drive_pages.index_of(present, place, was)] = new
        return present

    return _save(tx, source, name, put)


def show_beside(name: str, place: int, problem: RobotetherError | None = None) -> str:
    """Show what is wrong with a button at its position beside all of them."""
    del place
    return show_all(name, problem)


@form(blueprint, "/<int:place>/move", show_beside)
def move(tx: Transaction, source: Source, name: str, place: int) -> Saved:
    """Swap a button with its neighbour."""
    to = -1 if forms.choice("to", "Direction", ("up", "down")) == "up" else 1
    was = request.form.get("was", "")

    def swapped(present: list[Button]) -> list[Button]:
        at = drive_pages.index_of(present, place, was)
        if not 0 <= at + to < len(present):
            raise NotPossibleError(f"cannot move button {was}: it cannot move further")
        present[at], present[at + to] = present[at + to], present[at]
        return present

    _change(tx, source, name, swapped)
    return path_of(name, BUTTONS), f"Button {was} is moved."


def _remove(tx: Transaction, source: Source, name: str, place: int) -> None:
    was = request.form.get("was", "")

    def without(present: list[Button]) -> list[Button]:
        del present[drive_pages.index_of(present, place, was)]
        return present

    _change(tx, source, name, without)


def _save(
    tx: Transaction,
    source: Source,
    name: str,
    put: Callable[[list[Button], Button], list[Button]],
) -> Saved:
    """Let the form's button into the robot's."""
    seen_robots.require(tx, current_user.get(), name, "manage")
    with forms.named(FORM_NAMES):
        button = _sent()
        if forms.is_ticked("allow") and current_user.get().is_admin:
            drive_pages.allow(tx, source, name, button)
        drive_pages.change_buttons(tx, source, name, lambda present: put(present, button))
    return path_of(name, BUTTONS), f"Button {button.name} is saved."


def _change(tx: Transaction, source: Source, name: str, change_: drive_pages.Change) -> None:
    seen_robots.require(tx, current_user.get(), name, "manage")
    drive_pages.change_buttons(tx, source, name, change_)


def _page(
    robot: RobotRow,
    title: str,
    present: dict[str, str],
    was: str = "",
    problem: RobotetherError | None = None,
) -> str:
    """Return the form with the button's values, or as it was sent."""
    sent = {field: request.form.get(field, "") for field in (*EMPTY, "allow")}
    return render_template(
        "settings/button.html",
        name=robot.name,
        meant=forms.meant_mac(robot.mac),
        title=title,
        values=sent if problem else present,
        was=was,
        problem=problem,
        kinds=KINDS,
        words=WORDS,
        longest_target=ros.MAX_NAME_LENGTH,
        longest_name=MAX_NAME_LENGTH,
        longest_sends=MAX_FIELDS_BYTES,
    )


def _sent() -> Button:
    """Return the button in the form; raise FieldInvalidError."""
    kind = forms.choice("kind", "What it does", tuple(MEMBERS))
    target, sent = MEMBERS[kind]
    return buttons.parse_one(
        {
            "name": forms.text("name", WORDS["name"]["title"], MAX_NAME_LENGTH),
            "kind": kind,
            target: forms.text("target", WORDS["topic"]["title"], ros.MAX_NAME_LENGTH),
            "type": forms.optional_text("type", WORDS["type"]["title"], MAX_TYPE_LENGTH) or "",
            sent: drive_pages.read(request.form.get("sends", "").strip()),
            "confirm": forms.is_ticked("confirm"),
        }
    )


def _values(button: Button) -> dict[str, str]:
    return {
        "name": button.name,
        "kind": button.kind,
        "target": button.target,
        "type": button.type,
        "sends": json.dumps(json.loads(button.fields), ensure_ascii=False, indent=1),
        "confirm": "yes" if button.confirm else "",
    }


def _was(present: Button) -> str:
    """Return the name that the button had when its form was made."""
    return request.form.get("was", present.name)


def _robot(name: str) -> RobotRow:
    """Return the robot, for its managers."""
    with context().database.transaction() as tx:
        return seen_robots.require(tx, current_user.get(), name, "manage").robot


def _present(robot: RobotRow) -> tuple[Button, ...]:
    try:
        return robot_settings.parse(robot.settings).buttons
    except FieldInvalidError as problem:
        raise NotPossibleError(
            f"cannot change the buttons of robot {robot.name} until an admin has corrected its settings: "
            f"{problem.detail}"
        ) from problem


def _at(robot: RobotRow, place: int) -> Button:
    present = _present(robot)
    if not 1 <= place <= len(present):
        raise NotPossibleError(
            f"cannot find button {place} of robot {robot.name}: it may have been removed"
        )
    return present[place - 1]


def _confirmation_words(name: str, place: int) -> Words:
    robot = _robot(name)
    button = _at(robot, place)
    return {"name": name, "meant": robot.mac, "button": button.name, "was": _was(button)}


confirmation.register(
    blueprint,
    path_of("{name}", BUTTONS),
    _confirmation_words,
    ConfirmedAction(
        path="/<int:place>/remove",
        title="Remove button {button} of robot {name}?",
        effects=("Open pages keep it until they are reloaded.",),
        undo="Add it again; the audit log keeps what it sent.",
        button="Remove",
        done="Button {button} is removed.",
        do=_remove,
        hidden=(("was", "{was}"),),
    ),
)
