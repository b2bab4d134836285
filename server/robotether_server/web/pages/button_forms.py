"""The forms for a robot's buttons: add, change, remove, and put in order."""

import json
from collections.abc import Callable

from flask import Blueprint, redirect, render_template, request
from robotether_common import ros
from werkzeug.wrappers import Response as AnyResponse

from robotether_server import buttons, robot_settings
from robotether_server.api.context import context
from robotether_server.buttons import MAX_FIELDS_BYTES, MAX_NAME_LENGTH, MEMBERS, Button
from robotether_server.db import Transaction
from robotether_server.db.audit import Source
from robotether_server.problems import FieldInvalid, NotPossible, Problem
from robotether_server.services import drive_pages
from robotether_server.web import confirmation, current_user, forms
from robotether_server.web.confirmation import METHODS, ConfirmedAction
from robotether_server.web.pages.drive_page_form import path_of

blueprint = Blueprint("button_forms", __name__, url_prefix="/robots/<name>/settings/buttons")
blueprint.before_request(current_user.require_user)

KINDS = (("publish", "Publish a message"), ("call", "Call a service"))
MAX_TYPE_LENGTH = 140
EMPTY = {"name": "", "kind": "publish", "target": "", "type": "", "sends": "{}", "confirm": ""}


@blueprint.route("/new", methods=METHODS)
def add(name: str) -> AnyResponse | str | tuple[str, int]:
    """Add a button behind the others."""
    _present(name)
    return _form(name, f"Add a button to robot {name}", EMPTY, lambda all_, new: all_.append(new))


@blueprint.route("/<int:place>", methods=METHODS)
def change(name: str, place: int) -> AnyResponse | str | tuple[str, int]:
    """Change a button at its position."""
    present = _at(name, place)

    def put(all_: list[Button], new: Button) -> None:
        all_[drive_pages.placed(all_, place, _was(present))] = new

    title = f"Button {present.name} of robot {name}"
    return _form(name, title, _values(present), put, was=_was(present))


@blueprint.route("/<int:place>/remove", methods=METHODS)
def remove(name: str, place: int) -> AnyResponse:
    """Remove a button."""
    present = _at(name, place)
    action = ConfirmedAction(
        title=f"Remove button {present.name} of robot {name}?",
        effects=("Open pages keep it until they are reloaded.",),
        undo="Add it again; the audit log keeps what it sent.",
        button="Remove",
        done=f"Button {present.name} is removed.",
        back=f"{path_of(name)}#buttons",
        hidden=(("was", _was(present)),),
    )

    def without(all_: list[Button]) -> list[Button]:
        del all_[drive_pages.placed(all_, place, _was(present))]
        return all_

    return confirmation.run(action, lambda tx, source: _change(tx, source, name, without))


@blueprint.route("/<int:place>/move", methods=METHODS)
def move(name: str, place: int) -> AnyResponse:
    """Swap a button with its neighbour."""
    if request.method == "GET":
        return redirect(path_of(name))
    to = -1 if forms.choice("to", "Direction", ("up", "down")) == "up" else 1
    was = request.form.get("was", "")

    def swapped(all_: list[Button]) -> list[Button]:
        at = drive_pages.placed(all_, place, was)
        if not 0 <= at + to < len(all_):
            raise NotPossible(f"cannot move button {was}: it cannot move further")
        all_[at], all_[at + to] = all_[at + to], all_[at]
        return all_

    with context().database.transaction() as tx:
        _change(tx, current_user.source(), name, swapped)
    return confirmation.go_on(f"{path_of(name)}#buttons", f"Button {was} is moved.")


def _form(
    name: str,
    title: str,
    values: dict[str, str],
    put: Callable[[list[Button], Button], None],
    was: str = "",
) -> AnyResponse | str | tuple[str, int]:
    """Show the form with these values, or do its action with its button."""
    if request.method == "GET":
        return _page(name, title, values, was)
    try:
        button = _sent()
        with context().database.transaction() as tx:
            _save(tx, name, button, put)
    except Problem as problem:
        return _page(name, title, _typed(), was, problem), problem.status
    return confirmation.go_on(f"{path_of(name)}#buttons", f"Button {button.name} is saved.")


def _save(
    tx: Transaction, name: str, button: Button, put: Callable[[list[Button], Button], None]
) -> None:
    source = current_user.source()
    drive_pages.find_managed(tx, current_user.get(), name)
    if forms.is_ticked("allow") and current_user.get().is_admin:
        drive_pages.allow(tx, source, name, button)

    def changed(all_: list[Button]) -> list[Button]:
        put(all_, button)
        return all_

    drive_pages.change_buttons(tx, source, name, changed)


def _change(tx: Transaction, source: Source, name: str, change_: drive_pages.Change) -> None:
    drive_pages.find_managed(tx, current_user.get(), name)
    drive_pages.change_buttons(tx, source, name, change_)


def _page(
    name: str, title: str, values: dict[str, str], was: str, problem: Problem | None = None
) -> str:
    return render_template(
        "drive_button.html",
        name=name,
        title=title,
        values=values,
        was=was,
        problem=problem,
        kinds=KINDS,
        longest_name=MAX_NAME_LENGTH,
        longest_sends=MAX_FIELDS_BYTES,
    )


def _sent() -> Button:
    """Return the button in the form; raise FieldInvalid."""
    kind = forms.choice("kind", "What it does", tuple(MEMBERS))
    target, sent = MEMBERS[kind]
    return buttons.parse_one(
        {
            "name": forms.text("name", "Name", MAX_NAME_LENGTH),
            "kind": kind,
            target: forms.text("target", "Topic or service", ros.MAX_NAME_LENGTH),
            "type": forms.optional_text("type", "Type", MAX_TYPE_LENGTH) or "",
            sent: drive_pages.read(request.form.get("sends", "").strip()),
            "confirm": forms.is_ticked("confirm"),
        }
    )


def _typed() -> dict[str, str]:
    return {field: request.form.get(field, "") for field in (*EMPTY, "allow")}


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


def _present(name: str) -> tuple[Button, ...]:
    """Return the robot's buttons, for its managers."""
    with context().database.transaction() as tx:
        settings = drive_pages.find_managed(tx, current_user.get(), name).robot.settings
    try:
        return robot_settings.parse(settings).buttons
    except FieldInvalid as problem:
        raise NotPossible(
            f"cannot change the buttons of robot {name} until an admin has corrected its settings: {problem.detail}"
        ) from problem


def _at(name: str, place: int) -> Button:
    present = _present(name)
    if not 1 <= place <= len(present):
        raise NotPossible(f"cannot find button {place} of robot {name}: it may have been removed")
    return present[place - 1]
