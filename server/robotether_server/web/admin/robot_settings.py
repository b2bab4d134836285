"""/admin/robots/NAME/settings: what the robot's guard does and who may send what, all that is in force in one form.

The settings are kept as what differs from the defaults; relay and guard follow a change by themselves.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from flask import Blueprint, render_template, request

from robotether_server import robot_settings
from robotether_server.api.context import context
from robotether_server.db import Transaction
from robotether_server.db.audit import Source
from robotether_server.problems import FieldInvalid, Problem
from robotether_server.robot_settings import Settings, get_path, put_path
from robotether_server.services import robots as robot_service
from robotether_server.web import confirmation, forms
from robotether_server.web.admin import robots
from robotether_server.web.admin.robot_setting_fields import SECTIONS, SettingField, line_of
from robotether_server.web.confirmation import ConfirmedAction
from robotether_server.web.forms import Saved, form

blueprint = Blueprint("robot_settings", __name__, url_prefix="/robots/<name>/settings")

MAX_FIELD_LENGTH = 20_000


@dataclass(frozen=True)
class Filled:
    """A field with its text and the text of its default."""

    field: SettingField
    text: str
    default: str


def show(name: str, problem: Problem | None = None) -> str:
    """Show the form."""
    with context().database.transaction() as tx:
        present = robots.find(tx, name).robot.settings
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


@form(blueprint, "", show)
def save(tx: Transaction, source: Source, name: str) -> Saved:
    """Set all that the form has."""
    robot_service.change_settings(tx, source, name, _from_form)
    return robots.page_of(name), f"The safety and permissions of robot {name} are saved."


def _filled(field: SettingField, in_force: Settings, defaults: Settings) -> Filled:
    text = forms.value_text(get_path(in_force, field.path))
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
    if field.kind == "globs":
        return [line.strip() for line in text.splitlines() if line.strip()]
    if not text and field.kind == "limit":
        return None
    return forms.number_or_text(text)


def _unedited(present: Mapping[str, object]) -> Settings:
    return {name: value for name, value in present.items() if name not in ("guard", "policy")}


def _to_defaults(tx: Transaction, source: Source, name: str) -> None:
    robot_service.change_settings(tx, source, name, _unedited)


confirmation.register(
    blueprint,
    "/admin/robots/{name}/settings",
    robots.found,
    ConfirmedAction(
        path="/defaults",
        title="Reset safety and permissions of robot {name} to the defaults?",
        effects=(
            "No limits of speed and acceleration; it stops by itself after 0.5 s; drive topics /cmd_vel and */cmd_vel.",
            "Observers subscribe to everything, drivers drive, managers may do everything. The shell user stays.",
            "It applies at once. If it changes drive topics, command age or permissions, it stops the robot and "
            "disconnects everyone. They must reopen the page.",
        ),
        undo="Set them again; the audit log keeps what they were.",
        button="Back to the defaults",
        done="The safety and permissions of robot {name} are the defaults.",
        do=_to_defaults,
        onward="/admin/robots/{name}",
    ),
)
