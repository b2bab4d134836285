"""What a cell tells another, asked by a test in that one's place."""

import asyncio
from types import SimpleNamespace

import pytest
from fake_robot import HOST, WAIT_S
from relay_server import until
from robotether_server.relay.cells import feed as feed_module
from robotether_server.relay.cells.keys import PROOF_HEADER
from robotether_server.relay.cells.messages import PeerRobot


@pytest.fixture
def follow(http, cell_a, peer_keys, opened):
    async def connect(**changes):
        url = f"http://{HOST}:{cell_a.relay.peer_port}/cell/v1/fleet?cell=c"
        headers = {PROOF_HEADER: peer_keys.proof}
        return await opened.enter_async_context(http.ws_connect(url, headers=headers, **changes))

    return connect


async def read(connection, kind):
    async with asyncio.timeout(WAIT_S):
        while True:
            message = await connection.receive_json()
            if message["type"] == kind:
                return message


async def test_stops_go_before_robots_and_come_from_everywhere(follow, cell_a, cell_b, sim1):
    robot = await cell_a.robot(sim1)
    cell_b.relay.control.stops.stop(sim1, "ben", reason="smoke")
    await until(lambda: cell_a.relay.control.stops.of(7), "a knows")
    stop = cell_a.relay.control.stops.of(7)
    connection = await follow()
    await connection.receive_json()
    said = await connection.receive_json()
    stopped = {"type": "stop", "robot_id": 7, "by": "ben", "reason": "smoke"}
    assert said == stopped | {"at": said["at"]}
    await until(lambda: robot.session.stopped, "the guard has it")
    await cell_a.relay.control.stops.release(sim1, "ann")
    ended = await read(connection, "released")
    assert (ended["by"], ended["at"]) == ("ben", said["at"])
    assert stop.at.isoformat().startswith(ended["at"].removesuffix("Z"))


async def test_only_nginx_peer_listener_is_answered(http, cell_a, cell_b, peer_keys, sim1):
    base = f"http://{HOST}:{cell_a.relay.peer_port}"
    for path in ("/cell/v1/fleet", f"/robots/{sim1.name}/ros", "/api/v1/events", "/x"):
        for proof in ("", "0" * 64):
            async with http.get(base + path, headers={PROOF_HEADER: proof}) as answer:
                assert answer.status == 403
    proven = {PROOF_HEADER: peer_keys.proof}
    for url, status in ((base, 426), (cell_a.server.url, 404)):
        async with http.get(url + "/cell/v1/fleet", headers=proven) as answer:
            assert answer.status == status


async def test_a_cell_that_does_not_answer_pings_is_let_go(follow, cell_a, monkeypatch):
    """Until then it counts as one that learns of stops."""
    monkeypatch.setattr(feed_module, "SILENT_AFTER_S", 1.0)
    monkeypatch.setattr(feed_module, "PING_EVERY_S", 0.2)
    feeds = cell_a.relay.peer_feeds
    deaf = await follow(autoping=False)
    await until(lambda: feeds.is_followed_by("c"), "it follows")
    await until(lambda: not feeds.is_followed_by("c"), "it is let go")
    await deaf.close()


async def test_a_fleet_that_takes_long_to_send_arrives(
    follow, cell_a, memory_database, monkeypatch
):
    """The network is slow; to send the fleet anew each time would take as long."""
    monkeypatch.setattr(feed_module, "SILENT_AFTER_S", 1.0)
    monkeypatch.setattr(feed_module, "PING_EVERY_S", 0.2)
    write = feed_module._write

    async def write_slowly(connection, message):
        await asyncio.sleep(0.15)
        await write(connection, message)

    monkeypatch.setattr(feed_module, "_write", write_slowly)
    stops = cell_a.relay.control.stops
    fleet = [memory_database.add_robot(robot_id, f"r{robot_id}") for robot_id in range(20, 30)]
    for robot in fleet:
        stops.stop(robot, "ben")
    connection = await follow()
    assert [(await read(connection, "stop"))["robot_id"] for _ in fleet] == [*range(20, 30)]
    stops.stop(fleet[0], "carl")
    assert (await read(connection, "stop"))["by"] == "ben"
    assert (await read(connection, "stop"))["by"] == "carl"


async def test_a_stop_does_not_wait_until_a_fleet_is_sent(
    *, follow, cell_a, cell_b, sim1, monkeypatch
):
    """The other cell may have its robot."""
    for robot_id in range(20, 35):
        link = SimpleNamespace(robot_id=robot_id, kind="session", address="198.51.100.7")
        cell_a.relay.registry.make_current(link)
        cell_a.relay.registry.established(link)
    await until(lambda: cell_b.relay.peers.robot_count() == 15, "b knows of them")
    write = feed_module._write

    async def write_and_stop(connection, message):
        await write(connection, message)
        if isinstance(message, PeerRobot) and message.robot_id == 21:
            cell_a.relay.control.stops.stop(sim1, "ben")

    monkeypatch.setattr(feed_module, "_write", write_and_stop)
    monkeypatch.setattr(feed_module, "ROBOTS_AT_ONCE", 3)
    connection = await follow()
    received = [(await connection.receive_json())["type"] for _ in range(16)]
    assert received == ["hello", *["robot"] * 3, "stop", *["robot"] * 11]
