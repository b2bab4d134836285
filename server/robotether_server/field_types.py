"""What the fields of requests, records and answers hold, with their bounds; each name is a type for msgspec.

`schemas` reads by these types, and `api.description` describes by them. `extra` says what JSON Schema does not:
`longest` where the pattern alone describes the length, `most` for a bound of more than 63 bits, `must` for the end of
"it must be ...", `as_typed` for a text that keeps its white space. Pure.
"""

import datetime as dt
from typing import Annotated

from msgspec import Meta

from robotether_server import macs, ssh_keys, times

MAX_NAME_LENGTH = 63
PLAIN_NAME_PATTERN = "^[a-z0-9][a-z0-9._-]{0,62}$"
ROBOT_NAME_PATTERN = "^[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?$"

# A name that people choose.
Label = Annotated[
    str, Meta(min_length=1, max_length=MAX_NAME_LENGTH, description="Printable characters")
]
# For a new group or site: it is part of paths.
NewPlainName = Annotated[
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
PlainName = Annotated[
    str,
    Meta(
        extra_json_schema={"pattern": PLAIN_NAME_PATTERN, "maxLength": MAX_NAME_LENGTH},
        extra={"longest": MAX_NAME_LENGTH},
    ),
]
Fingerprint = Annotated[
    str,
    Meta(
        min_length=1,
        max_length=64,
        extra_json_schema={"examples": ["SHA256:47DEQpj8HBSa+/TImW+5JCeuQeRkm5NMpJWZG3hSuFU"]},
    ),
]
PublicKeyLine = Annotated[
    str,
    Meta(
        min_length=1,
        max_length=ssh_keys.MAX_LINE_LENGTH,
        description="One line as in a .pub file, without options",
        extra_json_schema={"examples": [ssh_keys.EXAMPLE]},
    ),
]
# Robots spell their MAC in several ways; macs.normalise checks it.
Mac = Annotated[
    str,
    Meta(
        max_length=macs.MAX_TEXT_LENGTH,
        description="MAC address of a network card, in any usual spelling",
        extra_json_schema={"minLength": 11, "examples": ["00:1b:44:11:3a:b7"]},
    ),
]
Hostname = Annotated[str, Meta(min_length=1, max_length=253)]
AgentVersion = Annotated[str, Meta(min_length=1, max_length=32)]
Count = Annotated[int, Meta(ge=0)]
Amount = Annotated[float, Meta(ge=0)]
Timestamp = Annotated[dt.datetime, Meta(tz=True)]
# In a request.
GivenTimestamp = Annotated[
    dt.datetime, Meta(tz=True, extra_json_schema={"maxLength": times.MAX_TEXT_LENGTH})
]
# Of a body with changes.
AT_LEAST_ONE = Meta(extra_json_schema={"minProperties": 1})
