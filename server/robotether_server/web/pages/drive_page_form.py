"""/robots/NAME/settings: the form for a robot's drive page. button_forms.py has its buttons.

It sets how the robot moves, its cameras, the stream request, and when driving pauses. For managers of the robot, admins
included. docs/reference/robot-settings.md describes `page` and `buttons`.
"""

from dataclasses import dataclass
from typing import Literal

from flask import Blueprint, render_template, request

from robotether_server import robot_settings
from robotether_server.api.context import context
from robotether_server.db import Transaction
from robotether_server.db.audit import Source
from robotether_server.page_settings import DEFAULTS, MAX_CAMERAS, TURNS, DriveType, Kind
from robotether_server.problems import FieldInvalid, Problem
from robotether_server.robot_settings import Settings
from robotether_server.services import drive_pages
from robotether_server.web import current_user, forms
from robotether_server.web.forms import Saved, form

KIND_WORDS: tuple[tuple[Kind, str], ...] = (
    ("differential", "Drives and turns (differential)"),
    ("holonomic", "Moves sideways too (holonomic)"),
    ("ackermann", "Steers like a car (Ackermann)"),
)
TYPE_WORDS: tuple[tuple[DriveType | Literal[""], str], ...] = (
    ("", "Automatic: TwistStamped from ROS 2 Jazzy on, else Twist"),
    ("geometry_msgs/Twist", "Twist"),
    ("geometry_msgs/TwistStamped", "TwistStamped"),
    ("ackermann_msgs/AckermannDriveStamped", "AckermannDriveStamped"),
)
_BY_TYPE = "found by its type"
MAX_FIELD_LENGTH = 300
# So many rows for further cameras than there are.
SPARE_ROWS = 2


@dataclass(frozen=True)
class PageField:
    """One member of `page` and its texts. `empty` is shown for a missing value; without it a value is required."""

    name: str
    label: str
    hint: str
    kind: Literal["number", "topic"] = "number"
    empty: str = ""


MOVING = (
    PageField(
        "drive_topic",
        "Drive topic",
        "One of the guard's drive topics.",
        "topic",
        "the page finds it",
    ),
    PageField(
        "max_speed_m_s",
        "Top speed (m/s)",
        "The most that the controls offer. The guard's own limit always holds.",
        empty="the guard's",
    ),
    PageField(
        "max_turn_rad_s", "Top turn (rad/s)", "As the top speed, for turning.", empty="the guard's"
    ),
    PageField("wheelbase_m", "Wheelbase (m)", "For robots that steer.", empty="not known"),
)
VIDEO = (
    PageField("quality_min", "Lowest quality", "1 to 100. On a slow link, quality falls to this."),
    PageField("quality_max", "Highest quality", "1 to 100. On a good link, quality rises to this."),
    PageField("fps", "Frames a second", "0.1 to 60."),
    PageField("latency_ms", "Highest age to aim for (ms)", "50 to 5000."),
    PageField("width", "Width (pixels)", "With the height, or neither.", empty="the camera's own"),
    PageField("height", "Height (pixels)", "With the width, or neither.", empty="the camera's own"),
)
TOPICS = (
    PageField("odometry_topic", "Odometry", "For the path.", "topic", _BY_TYPE),
    PageField("scan_topic", "Laser scan", "Drawn around the robot.", "topic", _BY_TYPE),
    PageField("map_topic", "Map", "Drawn under the robot.", "topic", _BY_TYPE),
    PageField("battery_topic", "Battery", "How full it is.", "topic", _BY_TYPE),
    PageField("diagnostics_topic", "Diagnostics", "What its parts say.", "topic", _BY_TYPE),
)
FIELDS = (*MOVING, *VIDEO, *TOPICS)


blueprint = Blueprint("drive_page", __name__, url_prefix="/robots/<name>/settings")
blueprint.before_request(current_user.require_user)


def show(name: str, problem: Problem | None = None) -> str:
    """Show the form and the buttons."""
    with context().database.transaction() as tx:
        present = drive_pages.find_managed(tx, current_user.get(), name).robot.settings
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
        words={
            "kinds": KIND_WORDS,
            "types": TYPE_WORDS,
            "moving": MOVING,
            "video": VIDEO,
            "topics": TOPICS,
        },
        texts=_texts(page),
        defaults={field.name: forms.value_text(DEFAULTS.as_dict()[field.name]) for field in FIELDS},
        turns=TURNS,
        buttons=settings.buttons,
    )


@form(blueprint, "", show)
def save(tx: Transaction, source: Source, name: str) -> Saved:
    """Set what the form has; the buttons have forms of their own."""
    drive_pages.find_managed(tx, current_user.get(), name)
    drive_pages.set_page(tx, source, name, _from_form())
    return path_of(name), f"The page of robot {name} is saved. Open pages keep the old one."


def path_of(name: str) -> str:
    """Return the path of the form."""
    return f"/robots/{name}/settings"


def _texts(page: Settings) -> dict[str, object]:
    """Return the texts of the fields: those sent, else the settings in force."""
    sent = request.form
    texts: dict[str, object] = {
        field.name: sent.get(field.name, forms.value_text(page[field.name])) for field in FIELDS
    }
    hold = page["hold_after_ms"]
    usual = hold if hold is not None else DEFAULTS.hold_after_ms
    return texts | {
        "kind": sent.get("kind", page["kind"]),
        "drive_type": sent.get("drive_type", page["drive_type"] or ""),
        "holds": "hold" in sent if sent else hold is not None,
        "hold_after_ms": sent.get("hold_after_ms", forms.value_text(usual)),
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
    """Return the rows that are not empty."""
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
    page["drive_type"] = _sent("drive_type") or None
    page["hold_after_ms"] = (
        forms.number_or_text(_sent("hold_after_ms")) if "hold" in request.form else None
    )
    page["cameras"] = [
        {"topic": topic, "name": name, "turned_deg": forms.number_or_text(turn)}
        for topic, name, turn in _sent_cameras()
    ]
    return page


def _value(field: PageField) -> object:
    text = _sent(field.name)
    if not text and field.empty:
        return None
    return text if field.kind == "topic" else forms.number_or_text(text)


def _sent(name: str) -> str:
    text = request.form.get(name)
    if text is None or len(text) > MAX_FIELD_LENGTH:
        raise FieldInvalid(f"cannot use page.{name}: it is missing or too long")
    return text.strip()
