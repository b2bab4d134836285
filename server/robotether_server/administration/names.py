"""What people call the things that they make: tokens and keys."""

from robotether_server.problems import FieldInvalid

LONGEST_NAME = 63


def check_name(field: str, name: str) -> None:
    """Raise FieldInvalid unless it is a text that fits its column and a line of a table."""
    if not 1 <= len(name) <= LONGEST_NAME or not name.isprintable() or name != name.strip():
        raise FieldInvalid(
            f"cannot use {field}: it must be a text of 1 to {LONGEST_NAME} printable characters"
        )
