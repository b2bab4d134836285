"""What is the same for all operations of the API."""

from __future__ import annotations

import datetime as dt
from typing import Any

import pytest
from msgspec import UNSET, Struct, UnsetType
from robotether_server.api.operations import plain


class Answer(Struct):
    at: dt.datetime
    settings: dict[str, Any]
    more: int | UnsetType = UNSET


def test_moments_are_texts_of_whole_seconds():
    timestamp = dt.datetime(2026, 1, 1, 12, 3, 0, 900000, dt.UTC)
    assert plain([Answer(timestamp, {"a": [None, 1.5]})]) == [
        {"at": "2026-01-01T12:03:00Z", "settings": {"a": [None, 1.5]}}
    ]


def sent(root, path, body, kind):
    answer = root.visitor.ask(
        "POST", f"/api/v1{path}", data=body, content_type=kind, headers=root.headers
    )
    return answer.status_code, answer.json.get("code", "")


def test_body_is_one_json_object(root):
    for number, kind in enumerate(("json", "json; charset=utf-8", "merge-patch+json")):
        assert sent(root, "/groups", b'{"name": "x%d"}' % number, f"application/{kind}")[0] == 201
    for data in (b"", b"{", b"[]", b"\xff\xfe", b"null", b"[" * 60000, b"1" * 5000):
        assert sent(root, "/groups", data, "application/json") == (422, "field_invalid")


@pytest.mark.parametrize("kind", [None, "text/plain", "application/x-www-form-urlencoded"])
def test_body_that_is_not_sent_as_json_is_refused(root, kind):
    body = b'{"robot": "sim1", "mode": "drive"}'
    assert sent(root, "/groups", body, kind) == (415, "unsupported_media_type")
    assert sent(root, "/tickets", body, kind)[0] == 201


def test_query_has_each_name_once(root):
    assert root.get("/audit?limit=1")["events"] == []
    for wrong in ("most=1", "limit=1&limit=2"):
        assert root.refused("GET", f"/audit?{wrong}") == (422, "field_invalid")
