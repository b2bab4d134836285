"""The blueprint that all modules of the API put their paths on."""

from typing import Any

from flask import Blueprint

from robotether_server.problems import RecordMissing, RobotUnknown

blueprint = Blueprint("api", __name__, url_prefix="/api/v1")


@blueprint.url_value_preprocessor
def check_names(_endpoint: str | None, values: dict[str, Any] | None) -> None:
    """Refuse names that nobody can have, as the database would take `sim1 ` for sim1."""
    given = values or {}
    for kind, problem in (
        ("robot", RobotUnknown),
        ("user", RecordMissing),
        ("group", RecordMissing),
        ("site", RecordMissing),
    ):
        name = given.get(kind, "")
        if name != name.strip():
            raise problem(f"cannot find {kind} {name!r}: a name has no spaces")
