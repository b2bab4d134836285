"""What is the same for all operations of the API."""

import pytest


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
