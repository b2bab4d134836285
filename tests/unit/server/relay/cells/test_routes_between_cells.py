"""A route from robot sim2 at cell b to robot sim1 at cell a, which runs it."""

import asyncio
import time
from contextlib import suppress
from dataclasses import dataclass, replace

import pytest
import pytest_asyncio
from fake_robot import HOST, WAIT_S
from relay_clients import refusal
from relay_server import BEN, EVE, until
from robotether_server.db.routes import RouteEnd
from robotether_server.relay.cells import feed
from robotether_server.relay.cells.keys import PROOF_HEADER
from robotether_server.relay.routes import routes as relay_routes
from robotether_server.settings import robot as robot_settings
from route_world import FOLLOW, SOURCE, TARGET, RouteWorld
from site_cells import SiteCell


@dataclass(kw_only=True)
class TwoCells(RouteWorld):
    a: SiteCell
    b: SiteCell


@pytest.fixture
def memory_database(memory_database, monkeypatch):
    monkeypatch.setattr(relay_routes, "RETRY_AFTER_S", 0.05)
    monkeypatch.setattr(relay_routes, "CHECK_EVERY_S", 0.05)
    # A frozen line is slow, not gone: else the cell ends the route, and what waits there is lost.
    monkeypatch.setattr(feed, "SILENT_AFTER_S", WAIT_S)
    memory_database.add_robot(SOURCE, "sim2", u5="manage")
    memory_database.grants |= {(5, TARGET): "manage"}
    memory_database.routes = [FOLLOW]
    return memory_database


@pytest_asyncio.fixture
async def world(cell_a, cell_b, memory_database):
    robots = memory_database.robots
    source = await cell_b.robot(robots[SOURCE], epoch=1)
    target = await cell_a.robot(robots[TARGET], epoch=1)
    world = TwoCells(cell_a.server, cell_a.database, target, source, a=cell_a, b=cell_b)
    await until(lambda: world.live(cell_a).get(1) == ("runs", ""), "the route runs")
    await until(lambda: source.topics, "the source is subscribed")
    return world


async def test_a_command_goes_on_under_the_lease_of_the_targets_cell(world):
    await world.send_until(world.published)
    stamp = world.published()[0]["robotether"]
    assert stamp["fence"] == 1
    assert 0 <= world.target.session.clock_ms() - stamp["t_ms"] < 10_000
    assert world.a.relay.control.describe(TARGET).driver.user == "eve (route)"
    assert world.live(world.b) == {1: ("elsewhere", "")}
    assert len(world.source.topics) == 1


async def test_what_waited_on_the_line_between_the_cells_is_dropped(world):
    """Nothing says that it is younger than the last ping before it."""
    await world.send_until(world.published)
    with world.b.listener.frozen():
        for _ in range(10):
            await world.send(0.25)
            await asyncio.sleep(0.03)
        await asyncio.sleep(1)
    await until(lambda: "old" in world.why(), "the first of them was dropped")
    published = world.published()
    assert 0.25 not in [message["msg"]["linear"]["x"] for message in published]
    await world.send_until(lambda: len(world.published()) > len(published))


@pytest.mark.parametrize("cell", ["a", "b"])
@pytest.mark.parametrize("robot_id", [SOURCE, TARGET])
async def test_it_ends_whichever_cell_learns_that_the_right_has_ended(world, cell, robot_id):
    site_cell = {"a": world.a, "b": world.b}[cell]
    grants = {key: level for key, level in site_cell.database.grants.items() if key[1] != robot_id}
    site_cell.database.grants = grants
    await until(lambda: not world.source.topics, "the robot sends the topic no more", 2)
    ends = [each.code for each in site_cell.database.written if isinstance(each, RouteEnd)]
    assert ends == ["rights_ended"]


async def test_a_source_that_its_policy_hides_is_not_read(world):
    """The target's cell may know of it later."""
    hidden = robot_settings.parse({"policy": {"manage": {"subscribe": ["/odom"]}}})
    robots = world.b.database.robots
    world.b.database.robots = {**robots, SOURCE: replace(robots[SOURCE], settings=hidden)}
    await until(lambda: "policy" in world.why(), "the page says so")
    await until(lambda: not world.source.topics, "the robot sends the topic no more")


async def test_only_cells_read_sources_and_only_of_routes_that_begin_there(world, http, peer_keys):
    proof = {PROOF_HEADER: peer_keys.proof}
    at_a, at_b = (f"http://{HOST}:{cell.relay.peer_port}" for cell in (world.a, world.b))
    for url, headers, status in [
        (f"{world.b.server.url}/cell/v1/routes/1", proof, 404),
        (f"{at_b}/cell/v1/routes/1", {}, 403),
        (f"{at_b}/cell/v1/routes/2", proof, 404),
        (f"{at_a}/cell/v1/routes/1", proof, 404),
        (f"{world.b.server.url}/cell/v1/routes?user_id=5", proof, 404),
        (f"{at_b}/cell/v1/routes?user_id=5", {}, 403),
        (f"{at_b}/cell/v1/routes?user_id=x", proof, 400),
    ]:
        assert await refusal(http, url, headers) == status


async def test_an_app_drives_a_robot_of_another_cell_until_it_leaves(world, http):
    for cell in (world.a, world.b):
        cell.database.routes = [replace(FOLLOW, source_id=None, source_app="joy")]
    away = {1: ("waits", "app joy is not connected")}
    await until(lambda: world.live(world.a) == away, "it waits for the app")
    async with http.ws_connect(world.b.server.app_url("joy", EVE)) as app:
        await until(lambda: world.live(world.a) != away, "a knows that b has the app")
        await app.send_json({"op": "advertise", "topic": "/cmd_vel", "type": FOLLOW.type})
        async with asyncio.timeout(WAIT_S):
            while not world.published():
                await _publish_for(app, 0.05)
        assert world.a.relay.control.describe(TARGET).driver.user == "eve (route)"
        assert world.live(world.b) == {1: ("elsewhere", "")}
        await app.send_json({"op": "unadvertise", "topic": "/cmd_vel"})
        why = "the app does not offer /cmd_vel"
        await until(lambda: world.why() == why, "a says what b knows")
    await until(lambda: world.live(world.a) == away, "it waits for the app again")


async def test_an_app_gets_what_a_robot_of_another_cell_sends(world, http):
    for cell in (world.a, world.b):
        cell.database.routes = [replace(FOLLOW, target_id=None, target_app="joy")]
    async with http.ws_connect(world.a.server.app_url("joy", EVE)) as app:
        await app.send_json({"op": "subscribe", "topic": "/cmd_vel", "type": FOLLOW.type})
        async with asyncio.timeout(WAIT_S):
            received = asyncio.create_task(app.receive_json())
            while not received.done():
                await world.send()
                await asyncio.sleep(0.05)
        assert received.result()["msg"] == {"linear": {"x": 0.5}}
        await until(lambda: world.live(world.a) == {1: ("runs", "")}, "it runs")
        assert world.live(world.b) == {1: ("elsewhere", "")}


async def _publish_for(app, time_s):
    end_s = time.monotonic() + time_s
    while time.monotonic() < end_s:
        halt = {"op": "publish", "topic": "/cmd_vel", "msg": {"linear": {"x": 0.0}}}
        await app.send_json(halt)
        with suppress(TimeoutError):
            await app.receive(timeout=0.02)


async def test_every_cell_shows_all_routes_and_apps_and_guesses_none(world, http):
    """Of a cell that does not answer, it shows what it knows itself."""

    async def shown_at_b(user=EVE):
        headers = world.b.database.bearer(user)
        async with http.get(f"{world.b.server.url}/api/v1/routes/live", headers=headers) as answer:
            body = await answer.json()
        return (
            [(route["state"], route["rate_hz"]) for route in body["routes"]],
            [(app["name"], app["machine"]) for app in body["apps"]],
        )

    async with (
        http.ws_connect(world.a.server.app_url("pad", EVE)),
        http.ws_connect(world.b.server.app_url("joy", EVE)),
    ):
        assert await shown_at_b() == ([("runs", 0)], [("joy", None), ("pad", "a")])
        assert await shown_at_b(BEN) == ([], [])
        with world.a.listener.frozen():
            assert await shown_at_b() == ([("elsewhere", None)], [("joy", None)])
