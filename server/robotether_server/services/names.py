"""What people call the things that they make: tokens, keys, groups and sites."""

import re

from robotether_server.problems import FieldInvalid

MAX_NAME_LENGTH = 63
PLAIN_NAME = re.compile(r"[a-z0-9][a-z0-9._-]{0,62}")


def check_name(field: str, name: str) -> None:
    """Raise FieldInvalid unless it is a text that fits its column and a line of a table."""
    if not 1 <= len(name) <= MAX_NAME_LENGTH or not name.isprintable() or name != name.strip():
        raise FieldInvalid(
            f"cannot use {field}: it must be a text of 1 to {MAX_NAME_LENGTH} printable characters"
        )


def check_plain_name(field: str, name: str) -> None:
    """Raise FieldInvalid unless it is a name as users have, which can stand in a path."""
    if not PLAIN_NAME.fullmatch(name):
        raise FieldInvalid(
            f"cannot use {field}: it must be 1 to {MAX_NAME_LENGTH} characters a-z, 0-9, ., _ and -, and begin with "
            "a letter or a digit"
        )
