"""The description of the API, and the API itself."""

import re
from dataclasses import replace

import pytest
from jsonschema import Draft202012Validator
from robotether_server.web import create_app
from web_visitor import Browser

# nginx gives these to the relay.
ELSEWHERE = {
    ("/api/v1/events", "get"),
    ("/api/v1/stop", "post"),
    ("/api/v1/routes/live", "get"),
    ("/api/v1/robots/{robot}/control", "get"),
    ("/api/v1/robots/{robot}/uplink", "get"),
    ("/api/v1/robots/{robot}/lease", "post"),
    ("/api/v1/robots/{robot}/release", "post"),
    ("/api/v1/robots/{robot}/stop", "post"),
    ("/api/v1/robots/{robot}/services/{service}", "post"),
    ("/api/v1/robots/{robot}/topics/{topic}", "get"),
}
IN_PATHS = {"robot": "sim1", "user": "ann", "group": "crew", "site": "lab"}
IN_PATHS |= dict.fromkeys(
    ("token_id", "key_id", "grant_id", "drive_id", "request_id", "recording_id", "route_id"), "1"
)
METHODS = {"get", "post", "put", "patch", "delete"}


@pytest.fixture
def document(program):
    answer = program.ask("GET", "/api/v1/openapi.json")
    assert answer.content_type == "application/json"
    return dict(answer.json)


def operations(document):
    for path, item in document["paths"].items():
        for method in METHODS & set(item):
            yield path, method, item[method]


def test_each_route_is_described_and_each_description_routed(app, document):
    served = {
        (re.sub(r"<(?:\w+:)?(\w+)>", r"{\1}", rule.rule), method.lower())
        for rule in app.url_map.iter_rules()
        if rule.rule.startswith("/api/")
        for method in rule.methods - {"HEAD", "OPTIONS"}
    }
    described = {(path, method) for path, method, _ in operations(document)}
    assert served == described - ELSEWHERE


def test_operations_have_names_of_their_own(document):
    """Generated clients make methods of them."""
    names = [described["operationId"] for _, _, described in operations(document)]
    assert len(names) == len(set(names))


def test_every_schema_is_one(document):
    assert document["openapi"] == "3.1.0"
    for name, schema in document["components"]["schemas"].items():
        Draft202012Validator.check_schema(schema)
        assert set(schema.get("required", [])) <= set(schema.get("properties", {})), name
        assert "\n " not in schema["description"], name


def test_every_other_method_is_refused_with_those_that_there_are(program, document):
    described = list(operations(document))
    for path, item in document["paths"].items():
        if any(path == other for other, _ in ELSEWHERE):
            continue
        there_are = {method.upper() for other, method, _ in described if other == path}
        real = path.format(**IN_PATHS)
        for method in {name.upper() for name in METHODS - set(item)} | {"TRACE"}:
            answer = program.ask(method, real)
            assert answer.status_code == 405, (method, path)
            allowed = set(answer.headers["Allow"].split(", "))
            assert allowed - {"HEAD", "OPTIONS"} == there_are


def test_database_that_is_away_is_said_so(web_settings):
    away = replace(web_settings, database=replace(web_settings.database, port=1))
    program = Browser(create_app(away).test_client())
    answer = program.ask("GET", "/api/v1/robots", headers={"Authorization": "Bearer rt_x"})
    assert (answer.status_code, answer.json["code"]) == (503, "store_unavailable")
    assert program.ask("GET", "/healthz").status_code == 200
