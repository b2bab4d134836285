"""The description of the API, and the API itself."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from robotether_server.settings import WebSettings
from robotether_server.web import create_app
from web_visitor import Browser


def test_api_describes_itself(program: Browser) -> None:
    """Every path under /api/v1 that Flask has stands in the document, with its methods."""
    document = program.ask("GET", "/api/v1/openapi.json").json
    assert document["openapi"].startswith("3.1")
    served = {
        (rule.rule, method.lower())
        for rule in program.client.application.url_map.iter_rules()
        if rule.rule.startswith("/api/v1/")
        for method in rule.methods - {"HEAD", "OPTIONS"}
    }
    described = {(path, method) for path, item in document["paths"].items() for method in item}
    assert served <= described
    assert json.dumps(document)


@pytest.mark.parametrize(
    ("method", "path", "status", "code"),
    [
        ("GET", "/api/v1/nothing", 404, "not_found"),
        ("GET", "/api/v1/join", 405, "method_not_allowed"),
    ],
)
def test_wrong_paths_and_methods_are_problems_too(
    program: Browser, method: str, path: str, status: int, code: str
) -> None:
    """Programs get JSON whatever happens."""
    answer = program.ask(method, path)
    assert (answer.status_code, answer.json["code"]) == (status, code)
    assert answer.content_type == "application/problem+json"


def test_database_that_is_away_is_said_so(web_settings: WebSettings) -> None:
    """503 with a code; the health check still answers."""
    away = replace(web_settings, database=replace(web_settings.database, port=1))
    program = Browser(create_app(away).test_client())
    answer = program.ask("GET", "/api/v1/robots", headers={"Authorization": "Bearer rt_x"})
    assert (answer.status_code, answer.json["code"]) == (503, "store_unavailable")
    assert program.ask("GET", "/healthz").status_code == 200
