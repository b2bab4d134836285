"""What several members of a robot's settings hold: patterns of names, and names of topics. Pure."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta
from robotether_common.ros import (
    GLOB_PATTERN,
    MAX_GLOB_LENGTH,
    MAX_GLOBS,
    MAX_NAME_LENGTH,
    Globs,
    is_glob,
)

from robotether_server.problems import FieldInvalid


def globs(given: object, path: str) -> Globs:
    """Return patterns for names; raise FieldInvalid."""
    if not isinstance(given, list | tuple) or len(given) > MAX_GLOBS:
        raise FieldInvalid(f"cannot use {path}: it must be a list of at most {MAX_GLOBS} names")
    for pattern in given:
        if not isinstance(pattern, str) or not is_glob(pattern):
            raise FieldInvalid(
                f"cannot use {path}: {str(pattern)[:40]!r} is no full name, such as /arm/move or */cmd_vel; a "
                f"name begins with / or *, has a-z, A-Z, 0-9, _, / and * and at most {MAX_GLOB_LENGTH} characters"
            )
    return Globs(dict.fromkeys(given))


GLOBS_SCHEMA = {
    "type": "array",
    "maxItems": MAX_GLOBS,
    "items": {"type": "string", "pattern": GLOB_PATTERN, "maxLength": MAX_GLOB_LENGTH},
    "description": "Names, in which * stands for any text",
}
GivenGlobs = Annotated[Globs, Meta(extra_json_schema=GLOBS_SCHEMA, extra={"read": globs})]
# As the relay takes names in messages (relay/rosbridge/operations.py), with their first `/`.
RosName = Annotated[
    str,
    Meta(
        max_length=MAX_NAME_LENGTH,
        pattern="^(/[A-Za-z0-9_]+)+$",
        extra={
            "exact": True,
            "must": "a full name such as /arm/move_1, of a-z, A-Z, 0-9, _ and /, and at most "
            f"{MAX_NAME_LENGTH} characters",
        },
    ),
]
