"""The live fleet: what one client is told, and the server-sent events that carry it."""

import asyncio
import json
import time
from contextlib import asynccontextmanager
from dataclasses import replace

import pytest
import pytest_asyncio
from fake_robot import WAIT_S
from jsonschema import Draft202012Validator
from relay_server import ANN, EVE, until
from robotether_server.api.description import document
from robotether_server.db.fleet import RelayRequest
from robotether_server.relay.channels.events import EVENTS_EVERY_S
from robotether_server.relay.robots.robot import Presence


@pytest.fixture
def robots(relay):
    return relay.relay.registry


@pytest.fixture
def fleet_events(relay):
    return relay.relay.fleet_events


@pytest_asyncio.fixture
async def subscriber(fleet_events):
    with fleet_events.subscribed(1) as subscriber:
        subscriber.first_event()
        yield subscriber


async def test_a_client_that_does_not_read_is_told_the_newest_state_only(
    fleet_events, subscriber, robots
):
    for turn in range(1000):
        robots.ensure_robot(7).presence = Presence(ros="ok" if turn % 2 else "down", video="ok")
        fleet_events.changed(7)
    (event,) = subscriber.pop_events()
    assert (event[0], event[1].ros, event[1].video) == ("robot", "ok", "ok")
    assert subscriber.pop_events() == []


async def test_each_step_of_a_request_for_help_is_an_event(relay, memory_database, subscriber):
    """Of a robot's requests the one counts that is with an operator; without a database they are unknown."""

    async def next_events():
        await relay.relay.fleet.poll()
        return [(name, robot.help) for name, robot in subscriber.pop_events()]

    waiting = RelayRequest(7, "waiting", 1.0, 1.0, None, None)
    for state in ("waiting", "accepted"):
        memory_database.requests = [replace(waiting, state=state), waiting]
        assert await next_events() == [("robot", state)]
    assert await next_events() == []
    memory_database.down = True
    assert await next_events() == [("robot", None)]
    memory_database.down, memory_database.requests = False, []
    assert await next_events() == [("robot", "none")]


async def test_the_version_of_the_row_stands_for_one_not_yet_told(fleet_events, robots, sim1):
    row = replace(sim1, agent_version="0.1.0")
    assert fleet_events.describe(row).agent_version == "0.1.0"
    assert not robots.robots(), "a page that lists robots keeps nothing of them"
    robots.ensure_robot(7).presence = Presence(online=True, agent_version="0.2.0")
    assert fleet_events.describe(row).agent_version == "0.2.0"


def validators():
    api = document()
    [content] = api["paths"]["/api/v1/events"]["get"]["responses"]["200"]["content"].values()
    kinds = [kind["properties"] for kind in content["schema"]["contentSchema"]["items"]["oneOf"]]
    shared = {"components": api["components"], "unevaluatedProperties": False}
    return {kind["event"]["const"]: Draft202012Validator(kind["data"] | shared) for kind in kinds}


VALIDATORS = validators()


class Events:
    def __init__(self, answer):
        self._content = answer.content

    async def next(self, name=None):
        async with asyncio.timeout(WAIT_S):
            while True:
                block = (await self._content.readuntil(b"\n\n")).decode()
                if block.startswith(":"):
                    continue
                head, data = block.strip().split("\n")
                event = head.removeprefix("event: ")
                sent = json.loads(data.removeprefix("data: "))
                VALIDATORS[event].validate(sent)
                if name in {None, event}:
                    return event, sent

    async def ended(self):
        await self._content.read()

    async def robot_with(self, **expected):
        while True:
            _, robot = await self.next("robot")
            if expected.items() <= robot.items():
                return robot


@pytest.fixture
def follow(relay, http, memory_database):
    @asynccontextmanager
    async def following(user):
        cookie = {
            "Cookie": f"__Host-robotether_login={memory_database.add_credential('login', user)}"
        }
        async with http.get(f"{relay.url}/api/v1/events", headers=cookie) as answer:
            assert answer.status == 200
            assert answer.content_type == "text/event-stream"
            yield Events(answer)

    return following


async def test_grants_and_names_show_and_remove_a_robot(sim1, memory_database, follow):
    """A page that goes by names sees the old one go."""
    async with follow(EVE) as events:
        assert await events.next() == ("fleet", [])
        memory_database.grants[EVE.id, sim1.id] = "observe"
        assert (await events.robot_with())["name"] == "sim1"
        memory_database.robots = {sim1.id: replace(sim1, name="turtle")}
        assert await events.next() == ("removed", {"name": "sim1"})
        assert (await events.robot_with())["name"] == "turtle"
        memory_database.add_robot(8, "sim2")
        memory_database.grants[EVE.id, 8] = "observe"
        assert (await events.robot_with())["name"] == "sim2"
        robots = memory_database.robots
        named = {sim1.id: "sim2", 8: "turtle"}
        memory_database.robots = {i: replace(robots[i], name=name) for i, name in named.items()}
        swap = [(event, data["name"]) for event, data in [await events.next() for _ in range(4)]]
        assert [event for event, _ in swap] == ["removed", "removed", "robot", "robot"]
        assert sorted(name for _, name in swap) == ["sim2", "sim2", "turtle", "turtle"]
        del memory_database.grants[EVE.id, 8]
        assert await events.next() == ("removed", {"name": "turtle"})
        memory_database.robots = {sim1.id: replace(sim1, name="turtle")}
        assert await events.next() == ("removed", {"name": "sim2"})
        robot = await events.robot_with()
        assert (robot["name"], robot["mac"]) == ("turtle", sim1.mac)
        del memory_database.grants[EVE.id, sim1.id]
        assert await events.next() == ("removed", {"name": "turtle"})


async def test_a_stream_ends_with_its_login_and_not_without_a_database(
    relay, robot, memory_database, follow
):
    async with follow(ANN) as events:
        await events.next("fleet")
        memory_database.down = True
        await until(lambda: not relay.relay.fleet.store_up, "the relay has noticed")
        robot.session.send(type="health", ros="down", video="ok", detail="", ros_exposed=False)
        await events.robot_with(ros="down")
        memory_database.down = False
        memory_database.credentials.clear()
        async with asyncio.timeout(WAIT_S):
            await events.ended()


async def test_a_robot_that_reports_without_a_pause_fills_no_stream(follow, fleet_events, robots):
    async with follow(ANN) as events:
        await events.next("fleet")
        started_s = time.monotonic()
        for turn in range(100):
            robots.ensure_robot(7).presence = Presence(online=True, rtt_ms=turn)
            fleet_events.changed(7)
            await asyncio.sleep(0.002)
        seen = [(await events.robot_with())["rtt_ms"]]
        while seen[-1] != 99:
            seen.append((await events.robot_with())["rtt_ms"])
        assert len(seen) <= (time.monotonic() - started_s) / EVENTS_EVERY_S + 2
