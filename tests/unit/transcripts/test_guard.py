"""What passes between the agent and its guard, and what the guard writes to the relay and to rosbridge."""

import asyncio
import json
import os
import re
import signal
from contextlib import suppress

import aiohttp
import pytest
from fake_guard import births, fake_guard_command, heard
from fake_rosbridge import FakeRosbridge
from guard_process import KEY, GuardClient, GuardHere
from robotether_agent.guard import agent_messages, child_process, fork_server
from robotether_agent.guard.supervisor import GuardSupervisor
from sim_client import until
from transcripts import UPGRADE, Transcript

WAIT_S = 60.0
LONG_S = 60.0
PATIENCE_MS = 60_000


@pytest.fixture
async def rosbridge():
    async with FakeRosbridge() as running:
        yield running


@pytest.fixture
async def guard(tmp_path, rosbridge, monkeypatch):
    """A guard to whom nobody is silent, and no command late, because the machine is busy."""
    for name in (
        "authorizer.AGENT_SILENT_S",
        "rosbridge.FULL_AFTER_S",
        "rosbridge.STALLED_AFTER_S",
    ):
        monkeypatch.setattr(f"robotether_agent.guard.{name}", LONG_S)
    monkeypatch.setattr(agent_messages, "TIMES_MS", (200, PATIENCE_MS))
    times = {"max_age_ms": PATIENCE_MS, "deadman_ms": PATIENCE_MS}
    async with GuardHere(tmp_path, rosbridge.port, **times) as running:
        await running.until(lambda: rosbridge.open > 0, "it has reached rosbridge", WAIT_S)
        yield running


async def test_what_the_agent_writes(tmp_path, recorded, monkeypatch):
    """Each line to a guard, and those that the next one gets when it is killed."""
    monkeypatch.setattr(child_process, "SILENCE_S", LONG_S)
    monkeypatch.setattr(child_process, "START_S", LONG_S)
    monkeypatch.setattr(child_process, "EXIT_S", LONG_S)
    monkeypatch.setattr(fork_server, "START_S", LONG_S)
    monkeypatch.setattr(fork_server, "ANSWER_S", LONG_S)
    agent = GuardSupervisor("ws://127.0.0.1:9090/", fake_guard_command(tmp_path, "serves"))
    running = asyncio.ensure_future(agent.run())

    async def ready(guards):
        def is_ready():
            ports = [birth["port"] for birth in births(tmp_path)]
            return len(ports) == guards and agent.view.port == ports[-1]

        await until("a guard is ready", is_ready, WAIT_S)

    await ready(1)
    agent.on_config({"key": KEY, "drive_topics": ["/cmd_vel"], "max_speed_m_s": 1.5}, direct=False)
    agent.on_lease(13, held=True)
    agent.on_stop("5f", "ben")
    await until("it is stopped", lambda: agent.view.stopped, WAIT_S)
    agent.on_release("77", "ann")
    await until("it is released", lambda: not agent.view.stopped, WAIT_S)
    agent.on_config({"key": "next"}, direct=True)
    agent.on_session_lost()
    agent.on_stop("79", "ben")
    await until("it is stopped again", lambda: agent.view.stopped, WAIT_S)
    os.kill(births(tmp_path)[-1]["pid"], signal.SIGKILL)
    await ready(2)
    await until("it has the stop", lambda: heard(tmp_path)[-1]["type"] == "stop", WAIT_S)
    running.cancel()
    with suppress(asyncio.CancelledError):
        await running
    transcript = Transcript()
    for line in heard(tmp_path):
        if line["type"] == "born":
            transcript.add("--- a guard starts")
        else:
            transcript.add("agent:", line)
    assert transcript == recorded


async def test_what_the_guard_writes(guard, rosbridge, recorded):
    """Its lines to the agent at its start, and when something changes."""
    transcript = Transcript()
    transcript.name(guard.port, "guard's port")
    position = 0

    async def add(event, **members):
        """Add the next line on the guard's state with these members."""
        nonlocal position

        def found():
            lines = enumerate(guard.lines)
            return [at for at, line in lines if at >= position and members.items() <= line.items()]

        await guard.until(lambda: bool(found()), event, WAIT_S)
        position = found()[0] + 1
        as_before, changes = transcript.changes(guard.lines[position - 1])
        transcript.add(f"guard, when {event}{as_before}:", changes)

    await add("it listens", type="ready")
    await add("it begins", type="guard")
    await add("it lives", type="tick")
    assert [line["type"] for line in guard.lines[:2]] == ["ready", "guard"]
    await guard.grant(14)
    await add("it knows a newer lease", type="guard")
    await add("it is released though nobody stopped it", type="guard")
    # Before it has driven: then it would be sent zeros for half a second.
    guard.tell(type="stop", id="5f", by="bën")
    await add("it is stopped", answers="5f")
    guard.tell(type="release", id="77", by="ann")
    await add("it is released", answers="77")
    guard.tell(type="lease", fence=15, held=True)
    async with GuardClient(guard.port, 15) as client:
        await client.drive(0.5)
        await add("the robot moves", moving=True)
        for wrong in ({"age_ms": 1e9}, {"robotether": {"t_ms": 0, "fence": 12}}, {"msg": 1}):
            await client.drive(0.5, **wrong)
        refused = {"old": 1, "fence": 1, "stopped": 0, "shape": 1, "held": 0}
        await add("it has refused three messages", refused=refused)
        await client.drive(0.0)
        await add("the robot stands", moving=False)
    keys = {line["type"]: sorted(line) for line in guard.lines}
    transcript.add("all kinds of lines, and their members:", keys)
    assert transcript == recorded


async def _handshake(port, upgrade, **headers):
    """Return the answer to a handshake that opens nothing."""
    sent = {f"Robotether-{name}": value for name, value in headers.items()}
    url = f"http://127.0.0.1:{port}/"
    async with (
        aiohttp.ClientSession() as http,
        http.get(url, headers={**upgrade, **sent}) as got,
    ):
        return f"{got.status} {got.reason}, {got.content_type}: {await got.text()}".rstrip("\n")


async def test_who_is_admitted(guard, rosbridge, recorded):
    """The answer to each handshake that opens nothing, and the close code of each connection that ends."""
    transcript = Transcript()
    transcript.name(rosbridge.port, "rosbridge's port")

    async def add(case, **headers):
        transcript.add(f"{case}:", await _handshake(guard.port, UPGRADE, **headers))

    async def add_end(case, fence, end):
        async with GuardClient(guard.port, fence) as client:
            await client.send(op="subscribe", topic="/echo")
            assert (await client.receive())["op"] == "subscribe"
            done = end()
            if done is not None:
                await done
            transcript.add(f"{case}:", str(await client.closed()))

    driver = {"Key": KEY, "Mode": "drive", "Fence": "13"}
    transcript.add("no upgrade:", await _handshake(guard.port, {}))
    await add("no key", Mode="drive", Fence="13")
    await add("another key", **(driver | {"Key": "other"}))
    await add("another mode", **(driver | {"Mode": "manage"}))
    await add("a number that is none", **(driver | {"Fence": "-1"}))
    await add("no session", **driver)
    await guard.grant(13)
    await add("an older lease", **(driver | {"Fence": "12"}))
    await add_end("lease over", 13, lambda: guard.tell(type="lease", fence=13, held=False))
    await add("a lease that is over", **driver)
    await guard.grant(14)
    await add_end("newer lease", 14, lambda: guard.tell(type="lease", fence=15, held=True))
    await add_end("session lost", 15, lambda: guard.tell(type="session", up=False))
    await guard.grant(16)
    await add_end("rosbridge ends", 16, lambda: rosbridge.sockets[-1].close(code=1011))
    await add_end("stop", 16, lambda: guard.tell(type="stop", id="5f", by="ben"))
    await add("stopped", **(driver | {"Fence": "17"}))
    await add_end("rosbridge gone", 0, rosbridge.stop)
    gone = await _handshake(guard.port, {})
    async with asyncio.timeout(WAIT_S):
        while gone.startswith("426"):  # until the guard has seen it
            gone = await _handshake(guard.port, {})
    transcript.add("no upgrade, without a rosbridge:", gone)
    await add("observing, without a rosbridge", Key=KEY, Mode="observe")
    await rosbridge.start()
    await add_end("guard ends", 0, lambda: guard.tell(type="exit"))
    assert transcript == recorded


# Each is sent on a connection of its own, which is answered once a second for each kind.
REFUSED = {
    "too old": {"age_ms": 1e9},
    "of the future": {"age_ms": -1e9},
    "without a stamp": {"robotether": None},
    "without a timestamp": {"robotether": {"fence": 13}},
    "of another lease": {"robotether": {"t_ms": 0, "fence": 12}, "id": "p1"},
    "no object": {"msg": 1},
    "unknown shape": {"msg": {}},
    "unknown axis": {"msg": {"linear": {"w": 1}}},
    "no number": {"msg": {"linear": {"x": "1"}}},
    "too fast for any robot": {"msg": {"linear": {"x": 1e10}}},
    "a frame_id of two lines": {"msg": {"twist": {}, "header": {"frame_id": "a\nb"}}},
    "advertise another type": '{"op":"advertise","topic":"/cmd_vel","type":"std_msgs/String"}',
    "relative name": '{"op":"publish","topic":"cmd_vel/","msg":{}}',
    "stamp on another topic": '{"op":"publish","topic":"/a","id":"x","robotether":{}}',
    "fragment": '{"op":"fragment","id":"f","data":"","num":0,"total":1}',
    "no op": '{"id":7}',
    "no object of JSON": "[1]",
    "no number of JSON": '{"op":"publish","topic":"/a","msg":NaN}',
    "a key twice": '{"op":"publish","op":"subscribe"}',
    "an operation in another": '{"op":"subscribe","x":{"op":"publish"}}',
}


async def test_what_is_refused(guard, rosbridge, recorded):
    """The status that each message gets which goes no further."""
    transcript = Transcript()

    async def add(case, message, fence=13):
        async with GuardClient(guard.port, fence) as client:
            if isinstance(message, str):
                await client.socket.send_str(message)
            else:
                await client.drive(0.5, **message)
            transcript.add(f"{case}:", await client.socket.receive_json(timeout=WAIT_S))

    await guard.grant(13)
    for case, message in REFUSED.items():
        await add(case, message)
    await add("publishing while observing", {}, 0)
    await add("advertising while observing", REFUSED["advertise another type"], 0)
    guard.reconfigure(direct=True)
    guard.tell(type="lease", fence=13, held=False)
    await guard.heard()
    guard.tell(type="stop", id="5f", by="ben")
    await guard.until(lambda: guard.state["stopped"], "it is stopped", WAIT_S)
    await add("stopped", {}, None)
    assert [message["op"] for message in rosbridge.got] == []
    assert transcript == recorded


def is_zero(text):
    """Whether it is a command to stand still."""
    operation = json.loads(text)
    is_drive = operation["op"] == "publish" and operation["topic"].endswith("/cmd_vel")
    return is_drive and not re.search("[1-9]", json.dumps(operation["msg"]))


async def test_guard_and_rosbridge(guard, rosbridge, recorded):
    """What rosbridge gets of each message, as text: another parser than the guard's reads it and acts on it."""
    transcript = Transcript()
    stamped = {"header": {"frame_id": "base", "stamp": {"sec": 1}}, "twist": {"angular": {"z": 1}}}
    car = {"drive": {"speed": 1, "steering_angle": -0.25, "jerk": 1e-7}}
    arrow = "geometry_msgs/msg/Twist"
    await guard.grant(13)
    async with GuardClient(guard.port, 13) as client:
        for message in (
            '{"op": "subscribe",  "topic": "/a", "x": "\\u00e4ä"}',
            '{"op":"publish","topic":"/echo","msg":{"x":1.50,"y":1e3}}',
            f'{{"op":"advertise","topic":"/cmd_vel","type":"{arrow}","latch":true}}',
            {"id": "p1", "latch": True, "queue_size": 1},
            {"id": 2, "msg": {"linear": {"x": 1, "y": -2.5e-7}}},
            {"topic": "/a/cmd_vel", "msg": stamped},
            {"topic": "/b/cmd_vel", "msg": car},
        ):
            before = len(rosbridge.raw)
            if isinstance(message, str):
                await client.socket.send_str(message)
            else:
                await client.drive(0.5, **message)
            await until("it came", lambda was=before: len(rosbridge.raw) > was, WAIT_S)
        transcript.add("the echo:", await client.socket.receive_str(timeout=WAIT_S))
        binary = b'{"op":"publish","topic":"/echo"}'
        await client.socket.send_bytes(binary)
        assert await client.socket.receive_bytes(timeout=WAIT_S) == binary
    await guard.until(lambda: not guard.state["moving"], "it stands", WAIT_S)
    texts = [each for each in rosbridge.raw if isinstance(each, str)]
    first_zero = list(map(is_zero, texts)).index(True)
    for text in texts[:first_zero]:
        transcript.add("rosbridge:", text)
    # Zeros to all topics, again and again for half a second.
    for text in sorted(set(texts[first_zero:])):
        transcript.add("rosbridge, at the driver's end:", text)
    assert transcript == recorded
