"""What the fields of requests, records and answers hold, with their bounds; each name is a type for msgspec.

`schemas` reads by these types, and `api.description` describes by them. `extra` says what JSON Schema does not:
`longest` where the pattern alone describes the length, `must` for the end of "it must be ...", `as_typed` for a text
that keeps its white space. Pure.
"""

from typing import Annotated

from msgspec import Meta

MAX_NAME_LENGTH = 63
PLAIN_NAME_PATTERN = "^[a-z0-9][a-z0-9._-]{0,62}$"
ROBOT_NAME_PATTERN = "^[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?$"

# What people call their things.
Label = Annotated[
    str, Meta(min_length=1, max_length=MAX_NAME_LENGTH, description="Printable characters")
]
# Of groups and sites: it can stand in a path.
PlainName = Annotated[
    str,
    Meta(
        max_length=MAX_NAME_LENGTH,
        pattern=PLAIN_NAME_PATTERN,
        extra={
            "must": f"1 to {MAX_NAME_LENGTH} characters a-z, 0-9, ., _ and -, and begin with a letter or a digit"
        },
    ),
]
# Names of what is there: one that nobody can have is not found, so the pattern is described and not checked.
RobotName = Annotated[
    str,
    Meta(
        extra_json_schema={"pattern": ROBOT_NAME_PATTERN, "examples": ["turtle"]},
        extra={"longest": MAX_NAME_LENGTH},
    ),
]
UserName = Annotated[
    str,
    Meta(extra_json_schema={"pattern": PLAIN_NAME_PATTERN}, extra={"longest": MAX_NAME_LENGTH}),
]
