"""The form for a robot's drive page: how it moves, its cameras, what is wanted of the picture, when driving is held."""

import re
from collections.abc import Mapping

from flask import Blueprint, render_template, request
from werkzeug.wrappers import Response as AnyResponse

from robotether_server import robot_settings
from robotether_server.api.context import context
from robotether_server.page_settings import DEFAULTS, MAX_CAMERAS, TURNS
from robotether_server.problems import FieldInvalid, Problem
from robotether_server.services import drive_pages, permissions
from robotether_server.setting_paths import Settings
from robotether_server.web import confirmation, current_user
from robotether_server.web.confirmation import METHODS
from robotether_server.web.pages import drive_page_fields
from robotether_server.web.pages.drive_page_fields import FIELDS, PageField

blueprint = Blueprint("page_form", __name__)

MAX_FIELD_LENGTH = 300
# So many rows for further cameras than there are.
SPARE_ROWS = 2
NUMBER = re.compile(r"\d{1,12}(\.\d{1,12})?", re.ASCII)


@blueprint.route("", methods=METHODS)
def show(name: str) -> AnyResponse | str | tuple[str, int]:
    """Show the form and the buttons, or save what the form says."""
    try:
        with context().database.transaction() as tx:
            present = permissions.find_managed(tx, current_user.get(), name).robot.settings
            if request.method == "POST":
                drive_pages.set_page(tx, current_user.source(), name, _from_form())
    except FieldInvalid as problem:
        return _page(name, present, problem), problem.status
    if request.method == "GET":
        return _page(name, present)
    return confirmation.go_on(
        path_of(name), f"The page of robot {name} is saved. Whoever has it open keeps the old one."
    )


def path_of(name: str) -> str:
    """Return the path of the form."""
    return f"/robots/{name}/settings"


def _page(name: str, present: Mapping[str, object], problem: Problem | None = None) -> str:
    try:
        settings = robot_settings.parse(present)
    except FieldInvalid as error:
        # Somebody wrote by SQL what nobody may set.
        settings, problem = robot_settings.DEFAULTS, problem or error
    page = settings.page.as_dict()
    return render_template(
        "drive_settings.html",
        name=name,
        problem=problem,
        words=drive_page_fields,
        texts=_texts(page),
        defaults={field.name: _text(DEFAULTS.as_dict()[field.name]) for field in FIELDS},
        turns=TURNS,
        buttons=settings.buttons,
    )


def _texts(page: Settings) -> dict[str, object]:
    """Return what stands in the fields: what was sent, or else what is in force."""
    sent = request.form
    texts: dict[str, object] = {
        field.name: sent.get(field.name, _text(page[field.name])) for field in FIELDS
    }
    hold = page["hold_after_ms"]
    usual = hold if hold is not None else DEFAULTS.hold_after_ms
    return texts | {
        "kind": sent.get("kind", page["kind"]),
        "holds": "hold" in sent if sent else hold is not None,
        "hold_after_ms": sent.get("hold_after_ms", _text(usual)),
        "cameras": _camera_rows(page["cameras"]),
    }


def _camera_rows(cameras: object) -> list[tuple[str, str, str]]:
    """Return topic, name and turn of each row, the spare ones included."""
    if request.form:
        rows = _sent_cameras()
    else:
        present = cameras if isinstance(cameras, list) else []
        rows = [(one["topic"], one["name"], str(one["turned_deg"])) for one in present]
    spare = [("", "", "0")] * SPARE_ROWS
    return [*rows, *spare][:MAX_CAMERAS]


def _sent_cameras() -> list[tuple[str, str, str]]:
    """Return the rows in which something stands."""
    columns = [request.form.getlist(column) for column in ("topic", "name", "turned_deg")]
    return [
        (topic.strip(), name.strip(), turn)
        for topic, name, turn in zip(*columns, strict=False)
        if topic.strip() or name.strip()
    ]


def _from_form() -> Settings:
    """Return the page of the form, unchecked."""
    page: Settings = {field.name: _value(field) for field in FIELDS}
    page["kind"] = _sent("kind")
    page["hold_after_ms"] = _number(_sent("hold_after_ms")) if "hold" in request.form else None
    page["cameras"] = [
        {"topic": topic, "name": name, "turned_deg": _number(turn)}
        for topic, name, turn in _sent_cameras()
    ]
    return page


def _value(field: PageField) -> object:
    text = _sent(field.name)
    if not text and field.empty:
        return None
    return text if field.kind == "topic" else _number(text)


def _sent(name: str) -> str:
    text = request.form.get(name)
    if text is None or len(text) > MAX_FIELD_LENGTH:
        raise FieldInvalid(f"cannot use page.{name}: it is missing or too long")
    return text.strip()


def _number(text: str) -> object:
    """Return what the text means; what is no number goes on as it is, and is refused with its name."""
    return float(text) if NUMBER.fullmatch(text) else text


def _text(value: object) -> str:
    if value is None:
        return ""
    # All digits that the form takes back: saved unchanged it must change nothing.
    return f"{value:.12g}" if isinstance(value, float) else str(value)
