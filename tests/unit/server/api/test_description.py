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
    # Generated clients make methods of them.
    names = [described["operationId"] for _, _, described in operations(document)]
    assert len(names) == len(set(names))


def test_every_schema_is_one(document):
    assert document["openapi"] == "3.1.0"
    for name, schema in document["components"]["schemas"].items():
        Draft202012Validator.check_schema(schema)
        assert set(schema.get("required", [])) <= set(schema.get("properties", {})), name
        assert "\n " not in schema["description"], name


def test_database_that_is_away_is_said_so(web_settings):
    away = replace(web_settings, database=replace(web_settings.database, port=1))
    program = Browser(create_app(away).test_client())
    answer = program.ask("GET", "/api/v1/robots", headers={"Authorization": "Bearer rt_x"})
    assert (answer.status_code, answer.json["code"]) == (503, "store_unavailable")
    assert program.ask("GET", "/healthz").status_code == 200
