"""A robot's settings as texts, for the form of policy and guard and the robot's page. Pure."""

from collections.abc import Mapping

from robotether_server import robot_settings
from robotether_server.problems import FieldInvalid
from robotether_server.setting_paths import get_path, is_in
from robotether_server.web.admin.robot_setting_fields import SECTIONS, SettingField


def summary(settings: Mapping[str, object]) -> list[tuple[str, str]]:
    """Return what of policy and guard differs from the defaults, as labels and texts."""
    try:
        given = robot_settings.parse(settings).as_given()
    except FieldInvalid as error:
        # Somebody wrote by SQL what nobody may set.
        return [("Not valid", error.detail)]
    return [
        (f"{section.title}: {field.label}", line_of(field, get_path(given, field.path)))
        for section in SECTIONS
        for field in section.fields
        if is_in(given, field.path)
    ]


def line_of(field: SettingField, value: object) -> str:
    """Return a value as one line; nothing has words of its own."""
    return text_of(value).replace("\n", ", ") or field.empty


def text_of(value: object) -> str:
    """Return a value as its field takes it: names one a line, and nothing for no limit."""
    if value is None:
        return ""
    if isinstance(value, list | tuple):
        return "\n".join(map(str, value))
    # All digits that the form takes back: saved unchanged it must change nothing.
    return f"{value:.12g}" if isinstance(value, float) else str(value)
