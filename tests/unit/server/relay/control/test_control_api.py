"""The HTTP requests that concern control: who may, what they do, and what they answer."""

import pytest
import pytest_asyncio
from relay_server import ANN, BEN, BOB, CARL, EVE, until
from robotether_server.relay.auth.credentials import Credentials

SIM1 = "/api/v1/robots/sim1"


@pytest_asyncio.fixture
async def people(relay, memory_database, sim1):
    """Bearer headers: ann and ben drive, bob observes, carl manages, eve sees nothing."""
    memory_database.grants[BEN.id, sim1.id] = "drive"
    memory_database.grants[CARL.id, sim1.id] = "manage"
    await relay.relay.fleet.poll()
    return {user.name: memory_database.bearer(user) for user in (ANN, BEN, CARL, EVE, BOB)}


@pytest.fixture
def ask(relay, http, people):
    async def send(method, path, by=None, json=None, **headers):
        headers = (people[by] if by else {}) | headers
        async with http.request(method, relay.url + path, json=json, headers=headers) as answer:
            return answer.status, await answer.json()

    return send


async def test_control_is_handed_to_who_is_named(relay, guarded, sim1, ros, ask):
    lease = f"{SIM1}/lease"
    async with ros():
        await until(lambda: relay.relay.control.driver(sim1.id), "ann drives")
        await ask("POST", lease, "ben", {"action": "ask"})
        to_carl = {"action": "hand_over", "to": "carl"}
        assert (await ask("POST", lease, "ann", to_carl))[1]["code"] == "nobody_asks"
        status, body = await ask("POST", lease, "ann", {"action": "hand_over", "to": "ben"})
        assert (status, body["reserved"]["user"]) == (200, "ben")


async def test_a_manager_stops_what_it_manages(relay, guarded, sim1, memory_database, ask):
    memory_database.add_robot(8, "sim2", u1="drive")
    await until(lambda: 8 in relay.relay.fleet.state().robots, "the relay knows both")
    assert (await ask("POST", "/api/v1/stop", "ann"))[1]["code"] == "grant_missing"
    assert relay.relay.control.stops.count() == 0
    status, body = await ask("POST", "/api/v1/stop", "carl")
    assert status == 200
    robots = [{"name": "sim1", "mac": sim1.mac, "stopped": True, "confirmed": True}]
    assert body == {"robots": robots, "cells_unreached": []}
    assert relay.relay.control.stops.of(8) is None


async def test_a_stop_follows_a_robot_whose_name_another_has(relay, sim1, memory_database, ask):
    """A page may have the name from before; without a robot of its MAC the name counts."""
    memory_database.add_robot(8, "sim2", u1="drive")
    await until(lambda: 8 in relay.relay.fleet.state().robots, "the relay knows both")
    stops = relay.relay.control.stops
    assert (await ask("POST", f"/api/v1/robots/sim2/stop?mac={sim1.mac}", "ann"))[0] == 200
    assert (stops.of(sim1.id) is None, stops.of(8)) == (False, None)
    path = "/api/v1/robots/sim2/stop?mac=02:00:00:00:00:99"
    assert (await ask("POST", path, "ann"))[0] == 200
    assert stops.of(8) is not None


@pytest.mark.parametrize(
    "call",
    [
        ("POST", "/api/v1/robots/sim2/lease", {"action": "ask"}),
        ("POST", "/api/v1/robots/sim2/release"),
        ("GET", "/api/v1/robots/sim2/control"),
        ("GET", "/api/v1/robots/sim2/uplink"),
        ("GET", "/api/v1/robots/sim2/topics/pose"),
        ("POST", "/api/v1/robots/sim2/services/arm", {}),
        ("GET", "/robots/sim2/video/stream"),
    ],
)
async def test_nothing_else_goes_to_a_robot_that_has_got_the_name(
    relay, sim1, memory_database, ask, call
):
    method, path, *body = call
    memory_database.add_robot(8, "sim2", u1="drive")
    await until(lambda: 8 in relay.relay.fleet.state().robots, "the relay knows both")
    wrong = ["mac=x", "mac="] if "video" in path else ["mac=x", "mac=", "mac_address=x"]
    assert (await ask(method, f"{path}?mac={sim1.mac}", "ann", *body))[1]["code"] == "robot_unknown"
    for query in wrong:
        assert (await ask(method, f"{path}?{query}", "ann", *body))[1]["code"] == "field_invalid"


async def test_head_is_answered_as_get(relay, sim1, http, people):
    for path in (f"{SIM1}/control", "/api/v1/routes/live"):
        async with http.head(relay.url + path, headers=people["ann"]) as answer:
            assert (answer.status, await answer.read()) == (200, b"")


async def test_bad_bodies_are_named(relay, sim1, ask):
    relay.relay.control.stops.stop(sim1, "ben")
    for path, body, status in (
        ("lease", {}, 422),
        ("lease", {"action": "ask", "x": 1}, 422),
        ("lease", {"action": "refuse", "to": "ben"}, 422),
        ("lease", {"action": "hand_over", "to": None}, 422),
        ("lease", {"action": "ask", "driver": "ben"}, 422),
        ("lease", {"action": "take", "driver": None}, 422),
        ("lease", {"action": "a" * 5000}, 413),
        # Half the name of a stop, or null, ends none.
        ("release", {"at": "2026-01-01T12:00:00Z"}, 422),
        ("release", {"by": None, "at": None}, 422),
        ("release", {"by": 7, "at": 7}, 422),
    ):
        answer = await ask("POST", f"{SIM1}/{path}", "ann", body)
        code = {422: "field_invalid", 413: "request_entity_too_large"}[status]
        assert (answer[0], answer[1]["code"]) == (status, code)
    assert relay.relay.control.stops.of(sim1.id)


async def test_who_stops_over_http_waits_behind_no_other_question(
    relay, guarded, people, ask, monkeypatch
):
    """Strangers who ask for anything else may fill the questions to the database."""
    user_of, asked = Credentials.user_of, []

    async def note(credentials, *credential, stops=False):
        asked.append(stops)
        return await user_of(credentials, *credential, stops=stops)

    monkeypatch.setattr(Credentials, "user_of", note)
    for path in (f"{SIM1}/stop", "/api/v1/stop", f"{SIM1}/release"):
        assert (await ask("POST", path, "carl"))[0] == 200
    assert asked == [True, True, False]


async def test_no_stop_fails_for_its_body(relay, guarded, sim1, http, people):
    """A program may know other members, or be cut off."""
    stops, headers = relay.relay.control.stops, people["bob"]
    as_json = {"Content-Type": "application/json"}
    for body in (b'{"why": "fire"}', b'{"reason": 7}', b'{"reason": "fi', b'"' + b"x" * 5000):
        url = f"{relay.url}{SIM1}/stop"
        async with http.post(url, data=body, headers=headers | as_json) as answer:
            assert answer.status == 200
        assert stops.of(sim1.id) is not None
        await stops.release(sim1, "ann")


async def test_no_stop_fails_for_a_content_type(relay, guarded, sim1, http, people):
    """That of a form is what curl sends by itself; nobody unpacks a body."""
    form = {"Content-Type": "application/x-www-form-urlencoded", "Content-Encoding": "br"}
    for path, by in ((f"{SIM1}/stop", "bob"), ("/api/v1/stop", "carl")):
        headers = people[by] | form
        async with http.post(
            relay.url + path, data=b'{"reason": "fire"}', headers=headers
        ) as answer:
            assert answer.status == 200
        assert relay.relay.control.stops.of(sim1.id).reason == "fire"
        await relay.relay.control.stops.release(sim1, "ann")


async def test_no_stop_fails_for_its_reason(relay, guarded, sim1, ask):
    for body in ({}, {"reason": None}, {"reason": 7}, {"reason": " "}, {"reason": "line\n" * 99}):
        odd = f"{SIM1}/stop?press={'x' * 99}&mac=x"
        for path, by in ((odd, "bob"), ("/api/v1/stop", "carl")):
            assert (await ask("POST", path, by, body))[0] == 200
            assert relay.relay.control.stops.of(sim1.id) is not None
            await relay.relay.control.stops.release(sim1, "ann")


async def test_a_press_that_came_on_the_connection_is_no_stop_behind_its_release(
    relay, guarded, sim1, ask, ros
):
    """A page says it in both ways, and HTTP may be late; the next press stops."""
    async with ros() as socket:
        await socket.send_json({"op": "robotether.stop", "press": "1"})
        await until(lambda: relay.relay.control.stops.of(sim1.id), "it is stopped")
    assert (await ask("POST", f"{SIM1}/release", "ann"))[0] == 200
    for press, is_stopped in (("1", False), ("2", True)):
        status, control = await ask("POST", f"{SIM1}/stop?press={press}", "ann")
        assert (status, control["stopped"] is not None) == (200, is_stopped)


async def test_a_body_is_json(relay, http, people):
    url = f"{relay.url}{SIM1}/release"
    async with http.post(url, data=b"by=x", headers=people["ann"]) as answer:
        assert answer.status == 415
    headers = people["ann"] | {"Content-Type": "application/json"}
    async with http.post(url, data=b"{", headers=headers) as answer:
        assert answer.status == 400


async def test_a_login_needs_a_page_of_this_site(relay, guarded, sim1, memory_database, ask):
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
