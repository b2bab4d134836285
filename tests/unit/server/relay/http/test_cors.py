"""What pages of other sites may read."""

from __future__ import annotations

import pytest
from robotether_server.store.fleet import User

ALLOWED = {"Origin": "https://lab.example"}
ASKS = {"Access-Control-Request-Method": "POST", "Access-Control-Request-Headers": "authorization"}
PATHS = [
    "/api/v1/robots/sim1/stop",
    "/api/v1/robots/sim1/release",
    "/api/v1/robots/sim1/lease",
    "/api/v1/robots/sim1/control",
    "/robots/sim1/video/stream",
    "/robots/sim1/video/snapshot",
]


@pytest.mark.parametrize("path", PATHS)
async def test_a_page_that_is_allowed_may_ask(relay, http, path):
    """A preflight says with which methods and headers, and never with a login."""
    async with http.options(relay.url + path, headers=ALLOWED | ASKS) as answer:
        assert answer.status == 204
        assert answer.headers["Access-Control-Allow-Origin"] == "https://lab.example"
        assert "POST" in answer.headers["Access-Control-Allow-Methods"]
        assert answer.headers["Access-Control-Allow-Headers"] == "Authorization, Content-Type"
        assert "Access-Control-Allow-Credentials" not in answer.headers
        assert answer.headers["Vary"] == "Origin"


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("origin", ["https://evil.example", "http://lab.example", "null", ""])
async def test_another_page_may_not(relay, http, path, origin):
    """Its preflight is refused, without a word that would allow anything."""
    async with http.options(relay.url + path, headers=ASKS | {"Origin": origin}) as answer:
        assert (answer.status, (await answer.json())["code"]) == (403, "origin_refused")
        assert "Access-Control-Allow-Origin" not in answer.headers


@pytest.mark.parametrize("path", ["/api/v1/stop", "/api/v1/events", "/robots/sim1/ros"])
async def test_other_paths_are_for_no_other_page(relay, http, path):
    """What is not in the contract stays shut."""
    async with http.options(relay.url + path, headers=ALLOWED | ASKS) as answer:
        assert answer.status == 405
        assert "Access-Control-Allow-Origin" not in answer.headers


async def test_options_that_is_no_preflight_is_answered_as_ever(relay, http):
    """405, as for any method that a path has not."""
    async with http.options(relay.url + PATHS[0], headers=ALLOWED) as answer:
        assert answer.status == 405


async def test_a_page_that_is_allowed_stops_a_robot_with_its_token(
    relay, robot, http, memory_database
):
    """It reads the answer, and a problem as well."""
    token = memory_database.add_credential("token", User(1, "ann"))
    headers = ALLOWED | {"Authorization": f"Bearer {token}"}
    for name, status in (("sim1", 200), ("nosuch", 404)):
        url = f"{relay.url}/api/v1/robots/{name}/stop"
        async with http.post(url, headers=headers) as answer:
            assert answer.status == status
            assert answer.headers["Access-Control-Allow-Origin"] == "https://lab.example"


async def test_a_program_without_an_origin_gets_no_word_of_it(relay, robot, http, memory_database):
    """Only what caches need."""
    token = memory_database.add_credential("token", User(1, "ann"))
    url = f"{relay.url}/api/v1/robots/sim1/control"
    async with http.get(url, headers={"Authorization": f"Bearer {token}"}) as answer:
        assert answer.status == 200
        assert "Access-Control-Allow-Origin" not in answer.headers
        assert answer.headers["Vary"] == "Origin"
