"""/robots/NAME/settings: a robot's settings in tabs, each of which saves its own.

Safety and permissions are for admins, the others for all managers of the robot. The settings are kept as what differs
from the defaults; relay and guard follow a change by themselves. button_forms.py has the tab of the buttons.
"""

import hashlib
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial

from flask import Blueprint, redirect, render_template, request
from werkzeug.wrappers import Response as AnyResponse

from robotether_server import schemas
from robotether_server.api.context import context
from robotether_server.db import Transaction, seen_robots
from robotether_server.db.audit import Source
from robotether_server.db.robots import RobotRow
from robotether_server.problems import (
    FieldInvalidError,
    FieldsInvalidError,
    GrantMissingError,
    RobotetherError,
)
from robotether_server.services import robots as robot_service
from robotether_server.settings import robot as robot_settings
from robotether_server.settings.page import MAX_CAMERAS, MAX_LABEL_LENGTH, TURNS, Camera
from robotether_server.settings.robot import GivenSettings, Settings, get_path, is_in, put_path
from robotether_server.web import confirmation, current_user, forms
from robotether_server.web.confirmation import ConfirmedAction, Words
from robotether_server.web.forms import Saved, form
from robotether_server.web.pages.setting_fields import (
    CAMERAS,
    CAMERAS_PATH,
    DRIVING,
    HELP,
    PERMISSIONS,
    RECORDING,
    SAFETY,
    TABS,
    SettingField,
    Tab,
    beside,
    line_of,
)

blueprint = Blueprint("robot_settings", __name__, url_prefix="/robots/<name>/settings")
blueprint.before_request(current_user.require_user)

MAX_FIELD_LENGTH = 20_000
RANGE = re.compile(r"a number from (\S+) to (\S+)")
# Number of empty rows for further cameras.
SPARE_ROWS = 2
DEFAULTS = robot_settings.DEFAULTS.as_dict()
PAGE_PATHS = (CAMERAS_PATH, *(field.path for tab in (CAMERAS, DRIVING) for field in tab.fields))


@blueprint.before_request
def lead_to_first_tab() -> AnyResponse | None:
    """Let managers who are no admins begin with the first tab that they have."""
    name = (request.view_args or {})["name"]
    if request.method == "POST" or request.path != path_of(name) or current_user.get().is_admin:
        return None
    with context().database.transaction() as tx:
        seen_robots.require(tx, current_user.get(), name, "manage")
    return redirect(tabs_of(name)[0][1])


def path_of(name: str, tab: Tab = SAFETY) -> str:
    """Return the path of a tab."""
    return f"/robots/{name}/settings{tab.path}"


def tabs_of(name: str) -> list[tuple[str, str]]:
    """Return titles and paths of the tabs that the user has."""
    is_admin = current_user.get().is_admin
    return [(tab.title, path_of(name, tab)) for tab in TABS if is_admin or not tab.is_for_admins]


def show(tab: Tab, name: str, problem: RobotetherError | None = None) -> str:
    """Show the form of a tab with what is in force, or as it was sent."""
    with context().database.transaction() as tx:
        robot = _robot(tx, name, tab)
    present = robot.settings
    try:
        robot_settings.parse(present)
    except FieldInvalidError as error:
        # Somebody wrote by SQL what nobody may set; the form brings the robot back.
        problem = problem or error
    return render_template(
        "settings/cameras.html" if tab is CAMERAS else "settings/form.html",
        name=name,
        tab=tab,
        tabs_of_user=tabs_of(name),
        texts={field.path: _text(field, present) for field in tab.fields},
        beside={field.path: beside(field, present) for field in tab.fields if field.beside},
        usual={field.path: line_of(field, get_path(DEFAULTS, field.path)) for field in tab.fields},
        ticked=[field.path for field in tab.fields if field.box and _is_ticked(field, present)],
        cameras=_camera_rows(present),
        camera_words=schemas.words(Camera),
        longest_name=MAX_LABEL_LENGTH,
        turns=[(turn, f"{turn}°") for turn in TURNS],
        was=request.form.get("was") or _digests(tab, present),
        meant=forms.meant_mac(robot.mac),
        problem=problem,
    )


def save(tab: Tab, tx: Transaction, source: Source, name: str) -> Saved:
    """Set what was changed in the tab, and nothing else: others may have saved the rest since it was shown."""
    _robot(tx, name, tab)
    values, was = _checked(tab), request.form.get("was", "").split()

    def changed(present: Mapping[str, object]) -> Settings:
        unchanged = {
            path: _present(path, present) for path in values if _digest(path, values) in was
        }
        return _changed(present, values | unchanged)

    robot_service.change_settings(tx, source, name, changed, None if tab.is_for_admins else "page")
    return path_of(name, tab), tab.saved.format(name=name)


for tab in (SAFETY, CAMERAS, DRIVING, PERMISSIONS, HELP, RECORDING):
    form(blueprint, tab.path, partial(show, tab))(partial(save, tab))


def _robot(tx: Transaction, name: str, tab: Tab) -> RobotRow:
    """Return a robot whose tab the user may change; raise RobotUnknownError or GrantMissingError."""
    seen = seen_robots.require(tx, current_user.get(), name, "manage")
    if tab.is_for_admins and not current_user.get().is_admin:
        raise GrantMissingError("These settings are for administrators.")
    return seen.robot


def _present(path: str, present: Mapping[str, object]) -> object:
    return get_path(present if is_in(present, path) else DEFAULTS, path)


def _digests(tab: Tab, present: Mapping[str, object]) -> str:
    """Return the digests of what a tab shows, for its form to send back."""
    values = {path: _present(path, present) for path in _paths(tab)}
    for field in tab.fields:
        # As the form sends back what is rounded there.
        if field.in_degrees and values[field.path] is not None:
            values[field.path] = field.value_of(field.text_of(values[field.path]))
    return " ".join(_digest(path, values) for path in values)


def _digest(path: str, values: Mapping[str, object]) -> str:
    # 15 and 15.0 are one number.
    plain = json.loads(json.dumps(values[path]), parse_int=float)
    text = json.dumps([path, plain], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _paths(tab: Tab) -> list[str]:
    return [*([CAMERAS_PATH] if tab is CAMERAS else []), *(field.path for field in tab.fields)]


def _text(field: SettingField, present: Mapping[str, object]) -> str:
    """Return what was sent, else what is in force; a number that its checkbox switches off has its default."""
    value = _present(field.path, present)
    if value is None and field.box:
        value = get_path(DEFAULTS, field.path)
    return request.form.get(field.path, field.text_of(value))


def _box(field: SettingField) -> str:
    return f"{field.path}.on"


def _is_ticked(field: SettingField, present: Mapping[str, object]) -> bool:
    return (
        forms.is_ticked(_box(field)) if request.form else _present(field.path, present) is not None
    )


def _camera_rows(present: Mapping[str, object]) -> list[tuple[str, str, str]]:
    """Return topic, name and turn of each row, the spare ones included."""
    if request.form:
        rows = _sent_cameras()
    else:
        cameras = get_path(present, CAMERAS_PATH)
        rows = [
            (
                str(camera.get("topic", "")),
                str(camera.get("name", "")),
                str(camera.get("turned_deg", 0)),
            )
            for camera in (cameras if isinstance(cameras, list) else [])
            if isinstance(camera, Mapping)
        ]
    return [*rows, *[("", "", "0")] * SPARE_ROWS][:MAX_CAMERAS]


def _sent_cameras() -> list[tuple[str, str, str]]:
    """Return the rows that are not empty."""
    columns = [request.form.getlist(column) for column in ("topic", "name", "turned_deg")]
    return [
        (topic.strip(), name.strip(), turn)
        for topic, name, turn in zip(*columns, strict=False)
        if topic.strip() or name.strip()
    ]


def _checked(tab: Tab) -> Settings:
    """Return the values of the form by their paths; raise FieldsInvalidError, which names every wrong one."""
    read: dict[str, Callable[[], object]] = {CAMERAS_PATH: _cameras} if tab is CAMERAS else {}
    read |= {field.path: partial(_value, field) for field in tab.fields}
    angles = {field.path for field in tab.fields if field.in_degrees}
    values: Settings = {}
    wrong: list[FieldInvalidError] = []
    for path, value in read.items():
        with _collected(wrong, in_degrees=path in angles):
            values[path] = value()
            schemas.read(put_path({}, path, values[path]), GivenSettings, of="settings")
    if wrong:
        raise FieldsInvalidError(wrong)
    return values


@contextmanager
def _collected(wrong: list[FieldInvalidError], *, in_degrees: bool) -> Iterator[None]:
    try:
        yield
    except FieldInvalidError as problem:
        detail = RANGE.sub(_range_in_degrees, problem.detail) if in_degrees else problem.detail
        wrong.append(FieldInvalidError(detail, problem.field))


def _range_in_degrees(range_: re.Match[str]) -> str:
    low, high = (math.degrees(float(bound)) for bound in range_.groups())
    # Within what is allowed.
    return f"a number from {math.ceil(low * 1000) / 1000:g} to {math.floor(high):g}"


def _cameras() -> object:
    return [
        {"topic": topic, "name": name, "turned_deg": forms.number_or_text(turn)}
        for topic, name, turn in _sent_cameras()
    ]


def _value(field: SettingField) -> object:
    """Return what a field has, unchecked."""
    text = request.form.get(field.path)
    if text is None or len(text) > MAX_FIELD_LENGTH:
        raise FieldInvalidError(f"cannot use {field.path}: it is missing or too long", field.path)
    text = text.strip()
    if field.kind == "globs":
        return [line.strip() for line in text.splitlines() if line.strip()]
    if field.box:
        return field.value_of(text) if forms.is_ticked(_box(field)) else None
    if not text and field.empty:
        return None
    if field.kind in ("number", "whole", "points"):
        return field.value_of(text)
    return text


def _changed(present: Mapping[str, object], values: Settings) -> Settings:
    """Return the settings with these values; what nobody may set goes from their part."""
    part = next(iter(values)).partition(".")[0]
    settings = {name: value for name, value in present.items() if name != part}
    others = {path: get_path(present, path) for path in PAGE_PATHS if is_in(present, path)}
    for path, value in (others | values).items():
        settings = put_path(settings, path, value)
    return settings


def _reset(tx: Transaction, source: Source, name: str) -> None:
    def without(present: Settings) -> Settings:
        return {part: value for part, value in present.items() if part not in ("guard", "policy")}

    robot_service.change_settings(tx, source, name, without)


def _confirmation_words(name: str) -> Words:
    with context().database.transaction() as tx:
        robot = _robot(tx, name, SAFETY)
    guard = robot_settings.DEFAULTS.guard
    blind = f"{guard.blind_m:g} m and {guard.blind_deg:g} degrees unseen"
    return {"name": name, "meant": robot.mac, "blind": blind}


confirmation.register(
    blueprint,
    path_of("{name}"),
    _confirmation_words,
    ConfirmedAction(
        path="/defaults",
        title="Reset safety and permissions of robot {name} to the defaults?",
        effects=(
            "No limits of speed and acceleration but one: the later the driver sees, the slower it drives ({blind}). "
            "It stops by itself after 0.5 s; drive topics /cmd_vel and */cmd_vel.",
            "Observers subscribe to everything, drivers drive, managers may do everything. The shell user stays.",
            "It applies at once. If it changes drive topics, command age or permissions, it stops the robot and "
            "disconnects everyone. They must reopen the page.",
        ),
        undo="Set them again; the audit log keeps what they were.",
        button="Reset to the defaults",
        done="The safety and permissions of robot {name} are the defaults.",
        do=_reset,
    ),
)
