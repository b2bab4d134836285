"""What the description of the API says, without its words."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from robotether_server.api.description import document
from syrupy.assertion import SnapshotAssertion

WORDS = ("title", "description", "examples")


def without_words(value: Any) -> Any:
    """Leave out what is for people; a property of such a name is an object."""
    if isinstance(value, dict):
        return {
            key: without_words(member)
            for key, member in value.items()
            if key not in WORDS or isinstance(member, dict)
        }
    return [without_words(item) for item in value] if isinstance(value, list) else value


def lines(value: Any, place: str = "", depth: int = 4) -> Iterator[str]:
    """Yield each part of an operation or a schema with its place."""
    if depth and isinstance(value, dict):
        for key in sorted(value):
            yield from lines(value[key], f"{place}{key} ", depth - 1)
    else:
        yield place + json.dumps(value, sort_keys=True, ensure_ascii=False) + "\n"


def test_description_of_the_api(recorded: SnapshotAssertion) -> None:
    """Each operation with its parameters, body and answers."""
    assert "".join(lines(without_words(document()))) == recorded
