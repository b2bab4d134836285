"""/admin/robots/NAME/settings: what the robot's guard does and who may send what, all that is in force in one form.

The settings are kept as what differs from the defaults; relay and guard follow a change by themselves.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass

from flask import Blueprint, render_template, request
from werkzeug.wrappers import Response as AnyResponse

from robotether_server import robot_settings
from robotether_server.api.context import context
from robotether_server.db import Transaction
from robotether_server.db.audit import Source
from robotether_server.problems import FieldInvalid, Problem
from robotether_server.robot_settings import Settings, get_path, put_path
from robotether_server.services import robots
from robotether_server.web import confirmation, current_user
from robotether_server.web.admin import robot_pages
from robotether_server.web.admin.robot_setting_fields import (
    SECTIONS,
    SettingField,
    line_of,
    text_of,
)
from robotether_server.web.confirmation import METHODS, ConfirmedAction

blueprint = Blueprint("robot_settings", __name__, url_prefix="/robots/<name>/settings")

MAX_FIELD_LENGTH = 20_000
NUMBER = re.compile(r"-?\d{1,12}(\.\d{1,12})?", re.ASCII)


@dataclass(frozen=True)
class Filled:
    """A field with its text and the text of its default."""

    field: SettingField
    text: str
    default: str


@blueprint.route("", methods=METHODS)
def show(name: str) -> AnyResponse | str | tuple[str, int]:
    """Show the form, or save it."""
    present = robot_pages.get(name).robot.settings
    if request.method == "GET":
        return _page(name, present)
    try:
        with context().database.transaction() as tx:
            robots.change_settings(tx, current_user.source(), name, _from_form)
    except Problem as problem:
        return _page(name, present, problem), problem.status
    return confirmation.go_on(
        robot_pages.page_of(name), f"The policy and the guard of robot {name} are set."
    )


@blueprint.route("/defaults", methods=METHODS)
def to_defaults(name: str) -> AnyResponse:
    """Go back to the defaults."""
    robot_pages.get(name)
    action = ConfirmedAction(
        title=f"Reset policy and guard of robot {name} to the defaults?",
        effects=(
            "No limits of speed and acceleration; it stops by itself after 0.5 s; drive topics /cmd_vel and */cmd_vel.",
            "Observers subscribe to everything, drivers drive, managers may do everything. The shell user stays.",
            "It applies at once. If this changes the policy, the drive topics or the oldest command, everybody is "
            "disconnected and has to open the robot's page again; a robot that is driven stops by itself.",
        ),
        undo="Set them again; the audit log keeps what they were.",
        button="Back to the defaults",
        done=f"The policy and the guard of robot {name} are the defaults.",
        back=f"{robot_pages.page_of(name)}/settings",
        onward=robot_pages.page_of(name),
    )

    def do(tx: Transaction, source: Source) -> None:
        robots.change_settings(tx, source, name, _unedited)

    return confirmation.run(action, do)


def _page(name: str, present: Mapping[str, object], problem: Problem | None = None) -> str:
    try:
        in_force = robot_settings.parse(present).as_dict()
    except FieldInvalid as error:
        # Somebody wrote by SQL what nobody may set; the form brings the robot back.
        in_force, problem = robot_settings.DEFAULTS.as_dict(), problem or error
    defaults = robot_settings.DEFAULTS.as_dict()
    sections = [
        (section, [_filled(field, in_force, defaults) for field in section.fields])
        for section in SECTIONS
    ]
    return render_template(
        "admin/robot_settings.html", name=name, sections=sections, problem=problem
    )


def _filled(field: SettingField, in_force: Settings, defaults: Settings) -> Filled:
    text = text_of(get_path(in_force, field.path))
    usual = line_of(field, get_path(defaults, field.path))
    return Filled(field, request.form.get(field.path, text), usual)


def _from_form(present: Mapping[str, object]) -> Settings:
    """Return the settings of the form, unchecked, and those that it does not have."""
    settings = _unedited(present)
    for section in SECTIONS:
        for field in section.fields:
            text = request.form.get(field.path)
            if text is None or len(text) > MAX_FIELD_LENGTH:
                raise FieldInvalid(f"cannot use {field.path}: it is missing or too long")
            settings = put_path(settings, field.path, _value(field, text.strip()))
    return settings


def _value(field: SettingField, text: str) -> object:
    """Return the value of a text; one that is no number stays a text, and the settings refuse it by its name."""
    if field.kind == "globs":
        return [line.strip() for line in text.splitlines() if line.strip()]
    if not text and field.kind == "limit":
        return None
    return float(text) if NUMBER.fullmatch(text) else text


def _unedited(present: Mapping[str, object]) -> Settings:
    return {name: value for name, value in present.items() if name not in ("guard", "policy")}
