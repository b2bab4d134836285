"""Forms that save: their paths, typed getters for what people fill in, and where a page says what is wrong.

A refusal names the field; _forms.html marks it, and the page begins with a summary that leads to it.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from http import HTTPStatus
from typing import NamedTuple, TypeVar

from flask import Blueprint, Flask, flash, g, redirect, request
from werkzeug.wrappers import Response as AnyResponse

from robotether_server.api.context import context
from robotether_server.db import Transaction, robots
from robotether_server.db.robots import RobotRow
from robotether_server.problems import (
    FieldInvalidError,
    RecordExistsError,
    RecordMissingError,
    RobotetherError,
)
from robotether_server.schemas import MAX_NAME_LENGTH, ROBOT_NAME_PATTERN
from robotether_server.web import current_user
from robotether_server.web.page_texts import whole_sentence

# As people write it in any language: 0.5 or 0,5.
NUMBER = re.compile(r"-?\d{1,12}([.,]\d{1,12})?", re.ASCII)
METHODS = ["GET", "POST"]
T = TypeVar("T", bound=str)
# Where to go on and what is said there; or a page, for a secret that no other page may hold.
Saved = tuple[str, str] | str
PageAnswer = AnyResponse | str | tuple[str, int]
S = TypeVar("S", bound=Callable[..., Saved])
# Fields that no page shows again, with their labels.
SECRETS = {
    "password": "Password",
    "present": "Present password",
    "new": "New password",
    "again": "New password again",
}


def form(blueprint: Blueprint, path: str, page: Callable[..., str]) -> Callable[[S], S]:
    """Let a POST to `path` call the function: `save(tx, source, **parts of the path)`, in a transaction of its own.

    GET shows `page(**parts)`, and so does a form that cannot be saved, with its `problem`. One of a robot sends its MAC
    as `meant`.
    """

    def register(save: S) -> S:
        def act(tx: Transaction, **parts: object) -> Saved | str:
            if "meant" in request.form:
                name = str(parts["name"])
                check_meant(name, robots.get(tx, name).mac)
            return save(tx, current_user.source(), **parts)

        def view(**parts: object) -> PageAnswer:
            if request.method != "POST":
                return page(**parts)
            try:
                saved = context().database.run(lambda tx: act(tx, **parts))
            except RobotetherError as problem:
                return page(**parts, problem=problem), problem.status
            return saved if isinstance(saved, str) else go_on(*saved)

        blueprint.add_url_rule(path, path or "/", view, methods=METHODS)
        return save

    return register


class WrongField(NamedTuple):
    """One line of the summary: what is wrong, and the field's id and label if it is one of the page."""

    sentence: str
    id: str = ""
    label: str = ""


def register(app: Flask) -> None:
    """Let templates mark wrong fields and sum them up."""
    app.add_template_global(wrong_at)
    app.add_template_global(wrong_fields)


def wrong_at(problem: RobotetherError | None, name: str, id_: str, label: str) -> str:
    """Return what is wrong with the field of this name, empty if nothing, and note where it is for the summary."""
    for cause in problem.each if problem else ():
        if cause.field == name:
            g.setdefault("marked", {})[name] = WrongField(cause.at_field, id_, label)
            return cause.at_field
    return ""


def wrong_fields(problem: RobotetherError) -> list[WrongField]:
    """Return the lines of the summary; the page's fields must have been drawn."""
    marked: dict[str, WrongField] = g.get("marked", {})
    return [
        marked.get(cause.field) or WrongField(whole_sentence(cause.detail))
        for cause in problem.each
    ]


@contextmanager
def named(fields: Mapping[str, str]) -> Iterator[None]:
    """Name the field of a refusal in the block as this form does: {name in the refusal: name in the form}."""
    try:
        yield
    except (FieldInvalidError, RecordExistsError) as problem:
        problem.field = fields.get(problem.field, problem.field)
        raise


def go_on(path: str, message: str) -> AnyResponse:
    """Redirect to another page, with a message about what was done. The message must hold no secret."""
    flash(message)
    return redirect(path, HTTPStatus.SEE_OTHER)


def text(name: str, label: str, longest: int) -> str:
    """Return a text of printable characters, without the white space around it."""
    value = optional_text(name, label, longest)
    if value is None:
        raise FieldInvalidError(f"cannot continue: fill in {label}", name)
    return value


def optional_text(name: str, label: str, longest: int) -> str | None:
    """Return a text as `text` does, or None when the field is empty."""
    value = request.form.get(name, "").strip()
    if len(value) > longest or not value.isprintable():
        raise FieldInvalidError(
            f"cannot use {label}: at most {longest} printable characters are allowed", name
        )
    return value or None


def robot_name(name: str, label: str) -> str:
    """Return a name that a robot may have."""
    value = text(name, label, MAX_NAME_LENGTH)
    if not re.fullmatch(ROBOT_NAME_PATTERN, value):
        raise FieldInvalidError(
            f"cannot use {label}: use a-z, 0-9 and -; begin and end with a letter or digit", name
        )
    return value


def meant_mac(mac: str) -> str:
    """Return the MAC of the robot whose form was opened; `mac` has it first, as another robot may get its name."""
    return request.form.get("meant", mac)


def check_meant(name: str, meant: str) -> None:
    """Raise RecordMissingError if the form is of what had this name when it was opened, and has it no longer."""
    if request.form.get("meant", meant) != meant:
        raise _another(name)


def robot_option(robot: RobotRow) -> str:
    """Return the value of an option that is a robot, which `chosen_robot` reads."""
    return f"{robot.name} {robot.mac}"


def chosen_robot(tx: Transaction, option: str) -> str:
    """Return the name of the robot that is chosen; raise RecordMissingError if another one has got it meanwhile."""
    name, _, mac = option.partition(" ")
    if mac and robots.get(tx, name).mac != mac:
        raise _another(name)
    return name


def _another(name: str) -> RecordMissingError:
    return RecordMissingError(
        f"cannot change {name}: what has this name now is another one; go back and open this page anew"
    )


def secret(name: str) -> str:
    """Return a password as it was typed; `name` is one of SECRETS."""
    if name not in SECRETS:
        raise KeyError(name)
    return request.form.get(name, "")


class KeptForm(NamedTuple):
    """A form to send once more: names and values of its fields, and names and labels of passwords to type again."""

    fields: list[tuple[str, str]]
    passwords: list[tuple[str, str]]


def keep() -> KeptForm:
    """Return the form that was sent, without its passwords and its token."""
    sent = [item for item in request.form.items(multi=True) if item[0] != "csrf_token"]
    typed = {name for name, value in sent if name in SECRETS and value}
    return KeptForm(
        [item for item in sent if item[0] not in typed],
        [(name, label) for name, label in SECRETS.items() if name in typed],
    )


def carry() -> KeptForm | None:
    """Return the form that waited for this log-in, if any."""
    sent = request.form.items(multi=True)
    fields = [(name.removeprefix("kept."), text) for name, text in sent if name.startswith("kept.")]
    typed = request.form.getlist("typed")
    passwords = [(name, SECRETS[name]) for name in typed if name in SECRETS]
    return KeptForm(fields, passwords) if fields or passwords else None


def number(name: str, label: str, lowest: int, highest: int) -> int:
    """Return a whole number within the bounds, both included."""
    value = optional_number(name, label, lowest, highest)
    if value is None:
        raise FieldInvalidError(f"cannot continue: fill in {label}", name)
    return value


def optional_number(name: str, label: str, lowest: int, highest: int) -> int | None:
    """Return a number as `number` does, or None when the field is empty."""
    value = request.form.get(name, "").strip()
    if not value:
        return None
    # Python takes digits of every script and underscores for a number; people mean neither.
    is_number = value.isascii() and value.isdigit() and len(value) <= len(str(highest))
    if not is_number or not lowest <= int(value) <= highest:
        raise FieldInvalidError(
            f"cannot use {label}: it must be a whole number from {lowest} to {highest}", name
        )
    return int(value)


def choice(name: str, label: str, allowed: tuple[T, ...]) -> T:
    """Return one of the allowed texts."""
    for value in allowed:
        if request.form.get(name) == value:
            return value
    raise FieldInvalidError(f"cannot use {label}: choose one of {', '.join(allowed)}", name)


def is_ticked(name: str) -> bool:
    """Return whether a checkbox is ticked."""
    return bool(request.form.get(name))


def number_or_text(text: str, *, whole: bool = False) -> object:
    """Return the value of a setting's text; one that is not a number stays a text, and the settings refuse it by name.

    A whole number has no comma: 2,000 is two thousand to some and two to others.
    """
    is_number = NUMBER.fullmatch(text) and not (whole and "," in text)
    return float(text.replace(",", ".")) if is_number else text


def value_text(value: object) -> str:
    """Return a setting as the text of its field: names one a line, an empty text for no value."""
    if value is None:
        return ""
    if isinstance(value, list | tuple):
        return "\n".join(map(str, value))
    # All digits that the form takes back: saved unchanged it must change nothing.
    return f"{value:.12g}" if isinstance(value, float) else str(value)
