"""What is the same for all operations of the API."""

from __future__ import annotations

import datetime as dt
from typing import Any

from api_visitor import Program
from msgspec import UNSET, Struct, UnsetType
from robotether_server.api.operations import plain
from web_visitor import Browser


class Answer(Struct):
    """An answer with a moment, and a member that may be left out."""

    at: dt.datetime
    settings: dict[str, Any]
    more: int | UnsetType = UNSET


def test_moments_are_texts_of_whole_seconds() -> None:
    """What else an answer has stays as it is."""
    moment = dt.datetime(2026, 1, 1, 12, 3, 0, 900000, dt.UTC)
    assert plain([Answer(moment, {"a": [None, 1.5]})]) == [
        {"at": "2026-01-01T12:03:00Z", "settings": {"a": [None, 1.5]}}
    ]


def test_who_asks_is_found_out_before_the_body_is_read(program: Browser, ann: Program) -> None:
    """Whoever may not do it learns nothing of what it takes."""
    answer = program.ask("POST", "/api/v1/groups", data="no JSON")
    assert (answer.status_code, answer.json["code"]) == (401, "login_missing")
    assert ann.refused("POST", "/groups", {"naem": "crew"}) == (403, "grant_missing")


def test_refused_body_is_told_by_its_field(root: Program) -> None:
    """415 for what is no JSON, 422 for a wrong field."""
    answer = root.visitor.ask("POST", "/api/v1/groups", data="{}", headers=root.headers)
    assert (answer.status_code, answer.json["code"]) == (415, "unsupported_media_type")
    answer = root.ask("POST", "/groups", {"name": "Crew"})
    assert (answer.status_code, answer.json["code"]) == (422, "field_invalid")
    assert answer.json["detail"].startswith("cannot use name: it must be 1 to 63 characters")
