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


def test_query_has_each_name_once_and_no_other(root):
    """Who filters by what is no filter would take all robots for some."""
    assert root.get("/audit?limit=1")["events"] == []
    for wrong in ("audit?most=1", "audit?limit=1&limit=2", "robots?site=a"):
        assert root.refused("GET", f"/{wrong}") == (422, "field_invalid")


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        ("POST", "/recordings", None),
        ("POST", "/requests", {"reason": "stuck"}),
        ("PATCH", "", {"state": "disabled"}),
        ("DELETE", "", None),
        ("GET", "/sessions", None),
        ("GET", "/controller", None),
    ],
)
def test_nothing_is_done_to_a_robot_that_has_got_the_name(root, method, path, body):
    mac = root.get("/robots/sim1")["mac"]
    wrong = root.refused(method, f"/robots/sim2{path}?mac={mac}", body)
    assert wrong == (404, "robot_unknown")
    for wrong in ("mac=x", f"macs={mac}"):
        assert root.refused(method, f"/robots/sim1{path}?{wrong}", body) == (422, "field_invalid")
    assert root.ask(method, f"/robots/sim1{path}?mac={mac.upper()}", body).status_code != 404
