"""A robot's link over a real socket: configuration, take-over, heartbeat, and each way it ends."""

import asyncio
import time
from contextlib import asynccontextmanager
from dataclasses import replace

import pytest
from fake_robot import HOST, WAIT_S
from local_network import free_port
from relay_clients import configured, ended
from relay_server import FAST, IMPATIENT, until
from robotether_common.services import BY_CONNECTION
from robotether_server.relay.robots.demand import Demand

SLOW_WHEN_IDLE = replace(FAST, idle_heartbeat_s=60.0)


def presence(relay, robot):
    return relay.relay.registry.presence(robot.id)


async def give_shell(relay, memory_database, robot):
    with_shell = replace(memory_database.robots[robot.id], shell_port=free_port())
    memory_database.robots = {robot.id: with_shell}
    await until(lambda: relay.relay.fleet.state().robots[robot.id] == with_shell, "it is known")
    return with_shell


@asynccontextmanager
async def port_taken(port):
    async with await asyncio.start_server(lambda _r, w: w.close(), HOST, port):
        yield


@pytest.mark.parametrize(
    ("new_port", "shell_hears"), [(lambda: None, "shell_off"), (free_port, "ports_changed")]
)
async def test_a_shell_port_that_is_taken_away_ends_every_link(
    *, relay, sim1, memory_database, connect, new_port, shell_hears
):
    """An old login may listen on it still: the others connect again, and so does a shell that has another."""
    with_shell = await give_shell(relay, memory_database, sim1)
    links = [await configured(await connect(kind)) for kind in ("session", "media", "shell")]
    memory_database.robots = {sim1.id: replace(with_shell, shell_port=new_port())}
    codes = [await ended(link) for link in links]
    assert codes == ["ports_changed", "ports_changed", shell_hears]


async def test_a_new_row_says_nothing_before_the_older_link_is_gone(
    relay, sim1, memory_database, connect
):
    """The agent opens its forwards on the configuration, so a new name waits with the rest of it."""
    async with port_taken(sim1.ros_port):
        waiting = await connect()
        memory_database.robots = {sim1.id: replace(sim1, name="turtle")}
        await until(lambda: "turtle" in relay.relay.fleet.state().by_name, "the name is known")
        assert waiting.configs == []
    await configured(waiting)
    assert [config["robot"] for config in waiting.configs] == ["turtle"]


async def test_a_flood_of_checks_gets_one_answer_and_stops_nothing(robot):
    """Pings are answered meanwhile, and the session's end ends a check that is under way."""
    for _ in range(50):
        robot.session.send(type="check")
    answer = {"type": "pong", "seq": 17, "t_ms": 5.0}
    robot.session.send(type="ping", seq=17, t_ms=5.0)
    await until(lambda: answer in robot.session.pongs, "the ping is answered")
    await until(lambda: robot.session.checked, "the check is answered")
    assert len(robot.session.checked) == 1


@pytest.mark.parametrize("kind", ["session", "media", "shell"])
async def test_a_port_that_stays_taken_goes_to_nobody(relay, sim1, memory_database, connect, kind):
    """Its holder would get the people who look for this robot, which comes in once the port is free."""
    with_shell = await give_shell(relay, memory_database, sim1)
    async with port_taken(with_shell.ports[BY_CONNECTION[kind].name]):
        began_s = time.monotonic()
        session = await connect(kind)
        assert await ended(session) == "port_taken"
        assert 0.9 < time.monotonic() - began_s < 5
        assert session.configs == []
        assert not presence(relay, sim1).online
    await configured(await connect(kind))


async def test_more_lines_than_allowed_end_the_session(connect):
    session = await configured(await connect())
    session.send_raw(b'{"type": "pong", "seq": 0}\n' * 300)
    session.send(type="ping", seq=17, t_ms=5.0)
    answer = {"type": "pong", "seq": 17, "t_ms": 5.0}
    await until(lambda: answer in session.pongs, "the session goes on")
    session.send_raw(b'{"type": "news"}\n' * 1000)
    assert await ended(session) == "protocol_error"


async def test_a_robot_is_asked_for_video_while_somebody_watches(relay, sim1, connect):
    demand = relay.relay.registry.ensure_robot(sim1.id).media_demand
    demand._kept_s = 0.2
    session = await configured(await connect())
    with demand.counted(), demand.counted():
        await until(lambda: session.configs[-1]["media"], "video is asked for")
        media = await configured(await connect("media"))
    with demand.counted():
        await asyncio.sleep(0.3)
    assert media.bye is None
    assert await ended(media) == "unwatched"
    await until(lambda: not session.configs[-1]["media"], "video is asked for no more")
    assert [config["media"] for config in session.configs] == [False, True, False]


async def test_a_robot_with_published_ports_is_always_needed():
    changes = []
    demand = Demand(lambda: changes.append(True), always=True, kept_s=0)
    with demand.counted():
        pass
    await asyncio.sleep(0.01)
    assert (changes, demand.exists) == ([], True)


@pytest.mark.parametrize("timing", [SLOW_WHEN_IDLE])
async def test_heartbeats_are_quick_while_somebody_uses_a_robot(relay, sim1, connect):
    relay.relay.registry.ensure_robot(sim1.id).usage._kept_s = 0.2
    session = await configured(await connect())
    await until(lambda: session.pings, "the round trip is measured")
    await asyncio.sleep(5 * FAST.heartbeat_s)
    assert session.pings == 1
    with relay.relay.registry.ensure_robot(sim1.id).usage.counted():
        await until(lambda: session.pings > 4, "heartbeats are quick")
    await until(lambda: len(session.configs) == 3, "nobody uses it any more")
    pings = session.pings
    await asyncio.sleep(5 * FAST.heartbeat_s)
    assert session.pings <= pings + 1
    idle_s = SLOW_WHEN_IDLE.idle_heartbeat_s
    assert [config["idle_heartbeat_s"] for config in session.configs] == [idle_s, None, idle_s]


@pytest.mark.parametrize("timing", [replace(IMPATIENT, idle_heartbeat_s=60.0)])
async def test_a_silent_robot_times_out(relay, sim1, connect):
    session = await connect(silent=True)
    began_s = time.monotonic()
    assert await ended(session) == "timeout"
    assert IMPATIENT.timeout_s < time.monotonic() - began_s < IMPATIENT.timeout_s + 3
    assert not presence(relay, sim1).online


@pytest.mark.parametrize("timing", [IMPATIENT])
async def test_a_relay_that_stood_still_ends_no_session(relay, sim1, connect):
    """What its robots sent meanwhile is not read yet."""
    session = await configured(await connect())
    asyncio.get_running_loop().call_soon(time.sleep, 3)
    await asyncio.sleep(0)
    pings = session.pings
    await until(lambda: session.pings > pings + 4, "the session goes on")
    assert session.bye is None
    assert presence(relay, sim1).online


async def test_a_robot_that_reads_nothing_is_bounded_and_ends(relay, sim1, connect, monkeypatch):
    monkeypatch.setattr("robotether_server.relay.robots.robot_link.LINES_AT_ONCE", 1_000_000)
    session = await configured(await connect())
    session._writer.transport.pause_reading()
    # The relay answers with the agent's own number, so a long one makes a long answer.
    line = b'{"type": "ping", "seq": ' + b"9" * 4000 + b', "t_ms": 5.0}\n'
    async with asyncio.timeout(WAIT_S):
        while presence(relay, sim1).online:
            session.send_raw(line * 100)
            await asyncio.sleep(0)
    assert b'sessions_closed_total{code="timeout"} 1.0' in relay.relay.metrics.render()
    await until(lambda: not relay.relay.sessions._live, "the link is cut")


async def test_each_session_has_its_own_guard_key(connect):
    """A key that somebody saw opens nothing after the next connection."""
    keys = {(await configured(await connect())).configs[0]["guard"]["key"] for _ in range(2)}
    assert len(keys) == 2
    assert min(map(len, keys)) >= 40
