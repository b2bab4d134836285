"""The HTTP requests that concern control: who may, what they do, and what they answer."""

import pytest
import pytest_asyncio
from relay_clients import audit_lines, closing
from relay_server import until
from robotether_server.db.fleet import RelayUser

ANN, BEN, CARL, EVE = (
    RelayUser(1, "ann"),
    RelayUser(3, "ben"),
    RelayUser(4, "carl"),
    RelayUser(5, "eve"),
)
SIM1 = "/api/v1/robots/sim1"


@pytest_asyncio.fixture
async def people(relay, memory_database, sim1):
    """Bearer headers: ann and ben drive, bob observes, carl manages, eve sees nothing."""
    memory_database.grants[BEN.id, sim1.id] = "drive"
    memory_database.grants[CARL.id, sim1.id] = "manage"
    await relay.relay.fleet.poll()
    return {
        user.name: {"Authorization": f"Bearer {memory_database.add_credential('token', user)}"}
        for user in (ANN, BEN, CARL, EVE, RelayUser(2, "bob"))
    }


@pytest.fixture
def ask(relay, http, people):
    async def send(method, path, by=None, json=None, **headers):
        headers = (people[by] if by else {}) | headers
        async with http.request(method, relay.url + path, json=json, headers=headers) as answer:
            return answer.status, await answer.json()

    return send


async def test_everybody_who_sees_a_robot_may_stop_it_and_drivers_release_it(relay, guarded, ask):
    """Each request is answered with the control object; a release of a robot that is free is none."""
    assert (await ask("POST", f"{SIM1}/stop", "eve"))[0] == 404
    status, body = await ask("POST", f"{SIM1}/stop", "bob", {"reason": "smoke"})
    assert status == 200
    assert (body["stopped"]["by"], body["stopped"]["confirmed"]) == ("bob", True)
    assert body["guard"] == "ready"
    assert (await ask("GET", f"{SIM1}/control", "ann"))[1] == body
    status, body = await ask("POST", f"{SIM1}/release", "bob")
    assert (status, body["code"]) == (403, "grant_missing")
    for _ in range(2):
        status, body = await ask("POST", f"{SIM1}/release", "ann")
        assert (status, body["stopped"]) == (200, None)


async def test_a_release_may_name_the_stop_that_it_ends(relay, guarded, sim1, ask):
    """Another one by then is 409; half a name is none, and nor is null."""
    first = (await ask("POST", f"{SIM1}/stop", "ann"))[1]["stopped"]
    second = (await ask("POST", f"{SIM1}/stop", "bob"))[1]["stopped"]
    del first["confirmed"], second["confirmed"]
    status, body = await ask("POST", f"{SIM1}/release", "ann", first)
    assert (status, body["code"]) == (409, "not_possible")
    assert body["detail"].startswith("bob stopped sim1 at ")
    for half in ({"by": "bob"}, {"at": second["at"]}, {"by": None, "at": None}, {"by": 7, "at": 7}):
        status, body = await ask("POST", f"{SIM1}/release", "ann", half)
        assert (status, body["code"]) == (422, "field_invalid")
    assert (await ask("GET", f"{SIM1}/control", "ann"))[1]["stopped"]["by"] == "bob"
    status, body = await ask("POST", f"{SIM1}/release", "ann", second)
    assert (status, body["stopped"]) == (200, None)


async def test_control_is_asked_for_and_handed_over(relay, guarded, sim1, http, ask):
    """The whole way over HTTP, and what is refused on it."""
    lease = f"{SIM1}/lease"
    assert (await ask("POST", lease, "ben", {"action": "ask"}))[1]["code"] == "lease_free"
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        await until(lambda: relay.relay.control.driver(sim1.id), "ann drives")
        assert (await ask("POST", lease, "bob", {"action": "ask"}))[1]["code"] == "grant_missing"
        assert (await ask("POST", lease, "ben", {"action": "take"}))[1]["code"] == "grant_missing"
        status, body = await ask("POST", lease, "ben", {"action": "ask"})
        assert (status, body["waiting"]["user"]) == (200, "ben")
        assert (await ask("POST", lease, "carl", {"action": "ask"}))[1]["code"] == "already_asked"
        code = (await ask("POST", lease, "ben", {"action": "hand_over"}))[1]["code"]
        assert code == "lease_not_yours"
        assert (await ask("POST", lease, "ann", {"action": "refuse"}))[1]["waiting"] is None
        assert (await ask("POST", lease, "ann", {"action": "refuse"}))[1]["code"] == "nobody_asks"
        await ask("POST", lease, "ben", {"action": "ask"})
        assert (await ask("POST", lease, "ben", {"action": "withdraw"}))[1]["waiting"] is None
        await ask("POST", lease, "ben", {"action": "ask"})
        to_carl = {"action": "hand_over", "to": "carl"}
        assert (await ask("POST", lease, "ann", to_carl))[1]["code"] == "nobody_asks"
        status, body = await ask("POST", lease, "ann", {"action": "hand_over", "to": "ben"})
        assert (status, body["reserved"]["user"]) == (200, "ben")
        assert (await closing(socket))[0] == 4010


async def test_who_asks_in_a_loop_is_told_to_wait(
    *, relay, guarded, sim1, http, people, ask, memory_database
):
    lease = f"{SIM1}/lease"
    async with http.ws_connect(relay.ros_url(sim1)):
        await until(lambda: relay.relay.control.driver(sim1.id), "ann drives")
        for _ in range(5):
            await ask("POST", lease, "ben", {"action": "ask"})
            await ask("POST", lease, "ben", {"action": "withdraw"})
        url, body = relay.url + lease, {"action": "ask"}
        async with http.post(url, json=body, headers=people["ben"]) as answer:
            assert (answer.status, (await answer.json())["code"]) == (429, "throttled")
            assert 0 < int(answer.headers["Retry-After"]) <= 30
        assert relay.relay.control.describe(sim1.id).waiting is None
    await relay.relay.event_writer.flush(5)
    assert [line.kind for line in audit_lines(memory_database)].count("lease_asked") == 3


async def test_a_manager_stops_what_it_manages(relay, guarded, sim1, memory_database, ask):
    memory_database.add_robot(8, "sim2", u1="drive")
    await until(lambda: 8 in relay.relay.fleet.state().robots, "the relay knows both")
    status, body = await ask("POST", "/api/v1/stop", "carl")
    assert status == 200
    robots = [{"name": "sim1", "stopped": True, "confirmed": True}]
    assert body == {"robots": robots, "cells_unreached": []}
    assert relay.relay.control.stops.of(8) is None
    assert (await ask("POST", "/api/v1/stop", "ann"))[1]["code"] == "grant_missing"
    status, body = await ask("POST", "/api/v1/stop", "carl", {"site": "nowhere"})
    assert (status, body["code"]) == (403, "grant_missing")


@pytest.mark.parametrize(
    ("body", "status", "code"),
    [
        ({"action": "dance"}, 422, "field_invalid"),
        ({"action": 7}, 422, "field_invalid"),
        ({}, 422, "field_invalid"),
        ({"action": "ask", "x": 1}, 422, "field_invalid"),
        ({"action": "refuse", "to": "ben"}, 422, "field_invalid"),
        ({"action": "hand_over", "to": None}, 422, "field_invalid"),
        (["ask"], 422, "field_invalid"),
        ({"action": "a" * 5000}, 413, "request_entity_too_large"),
    ],
)
async def test_bad_bodies_are_named(relay, ask, body, status, code):
    answer = await ask("POST", f"{SIM1}/lease", "ann", body)
    assert (answer[0], answer[1]["code"]) == (status, code)


@pytest.mark.parametrize("body", [None, {}, {"reason": None}, {"reason": ""}, {"reason": " "}])
async def test_no_stop_fails_for_lack_of_a_reason(relay, guarded, sim1, ask, body):
    """One robot and all of them stop without a reason, with an empty one, and with null."""
    for path, by in ((f"{SIM1}/stop", "bob"), ("/api/v1/stop", "carl")):
        assert (await ask("POST", path, by, body))[0] == 200
    assert relay.relay.control.stops.of(sim1.id) is not None


async def test_a_body_is_json(relay, http, people):
    url = f"{relay.url}{SIM1}/stop"
    async with http.post(url, data=b"reason=x", headers=people["ann"]) as answer:
        assert answer.status == 415
    headers = people["ann"] | {"Content-Type": "application/json"}
    async with http.post(url, data=b"{", headers=headers) as answer:
        assert answer.status == 400


async def test_a_login_needs_a_page_of_this_site(relay, guarded, sim1, memory_database, ask):
    """Without Origin and header a login changes nothing; another site's page is refused as such."""
    cookie = {"Cookie": f"__Host-robotether_login={memory_database.add_credential('login', ANN)}"}
    path = f"{SIM1}/stop"
    assert (await ask("POST", path, **cookie))[1]["code"] == "csrf_refused"
    headers = cookie | {"Origin": "https://evil.example", "X-CSRFToken": "x"}
    assert (await ask("POST", path, **headers))[1]["code"] == "origin_refused"
    assert (await ask("POST", path))[1]["code"] == "login_missing"
    assert relay.relay.control.stops.of(sim1.id) is None
    own = cookie | {"Origin": relay.url.replace("http:", "https:")}
    assert (await ask("POST", path, **own))[0] == 200
    assert (await ask("POST", f"{SIM1}/release", **cookie, **{"X-CSRFToken": "x"}))[0] == 200
    assert (await ask("GET", f"{SIM1}/control", **cookie))[0] == 200
