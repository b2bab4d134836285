"""Typed getters for the fields of an operation; their errors name the field."""

from collections.abc import Mapping
from typing import Any, TypeVar

from sim_robot.problems import FieldMissing, OperationFieldInvalid

Operation = Mapping[str, Any]
T = TypeVar("T")


def text(operation: Operation, name: str) -> str:
    """Get a string that must be there."""
    value = optional_text(operation, name)
    if value is None:
        raise FieldMissing(f"Expected a {name} field but none was found")
    return value


def optional_text(operation: Operation, name: str) -> str | None:
    """Get a string, or None if the field is left out."""
    return _optional(operation, name, str, "a string")


def optional_object(operation: Operation, name: str) -> dict[str, Any] | None:
    """Get an object, or None if the field is left out."""
    return _optional(operation, name, dict, "an object")


def optional_flag(operation: Operation, name: str) -> bool | None:
    """Get true or false, or None if the field is left out."""
    return _optional(operation, name, bool, "true or false")


def count(operation: Operation, name: str) -> int:
    """Get a whole number that is not negative, 0 if the field is left out."""
    value = operation.get(name, 0)
    if type(value) is not int or value < 0:
        raise OperationFieldInvalid(
            f"Expected field {name} to be a whole number from 0, not {value!r:.60}"
        )
    return value


def identity(operation: Operation) -> str | int | None:
    """Get the field id, None if it is left out."""
    value = operation.get("id")
    if value is None or type(value) in (str, int):
        return value
    raise OperationFieldInvalid(
        f"Expected field id to be a string or a whole number, not {value!r:.60}"
    )


def _optional(operation: Operation, name: str, kind: type[T], what: str) -> T | None:
    value = operation.get(name)
    if name not in operation or isinstance(value, kind):
        return value
    raise OperationFieldInvalid(f"Expected field {name} to be {what}, not {value!r:.60}")
