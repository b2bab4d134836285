"""What passes between operators, the relay and robots' rosbridge, and how their connections end."""

import asyncio
import json
import re
import struct
from contextlib import AsyncExitStack, suppress
from dataclasses import replace

from aiohttp import WSMsgType
from msgspec import structs
from relay_clients import closing
from relay_server import ANN, BOB, CARL, until
from robotether_server.relay.channels.rosbridge import message_validator
from robotether_server.settings.robot import Limits
from transcripts import UPGRADE, Transcript, problem_line

WAIT_S = 60.0
MEASURED = ("t_ms", "relay_ms")
# A connection gets ten refusals at once.
ANSWERS = 8


async def outcomes(world, robot, texts, user=ANN):
    """Send each message; return who has it in the end, the robot or the relay, and what that one wrote."""
    found = []
    topics = world.relay.relay.shared_topics
    for begin in range(0, len(texts), ANSWERS):
        # What the one before subscribed to reaches the robot anew.
        await until(lambda: topics.count() == 0, "no topic is shared", WAIT_S)
        async with world.connect("drive", user) as socket:
            for text in texts[begin : begin + ANSWERS]:
                # Each is answered: by the robot, which sends back what it got, or by the relay.
                before = len(robot.received)
                await socket.send_str(text)
                answer = await asyncio.wait_for(socket.receive_str(), WAIT_S)
                got = [str(data) for data in robot.received[before:]]
                found.append(("robot", got[0]) if got else ("relay", answer))
    return found


# Another parser than the relay's reads what reaches the robot.
WRITTEN = [
    '{"op": "subscribe",  "topic": "pose", "message_intervall": 9, "x": {"op": "publish"}}',
    '{"op":"subscribe","topic":"/\\u0070ose2","type":null,"throttle_rate":0}',
    '{"op":"call_service","service":"/rosapi/topics","timeout":3,"args":{"a":-0.0,"b":1e22}}',
    '{"op":"publish","topic":"/chatter","msg":{"a":"\\u00fc\\ud83d\\ude00/<\\u0000","z":[1.0,1e-7,1E400]}}',
    '{"op":"publish","topic":"/chatter","msg":{"z":1,"a":"\\u00fc\\ud83d\\ude00/<\\u0000"}}',
    '{"msg":{"data":[null,true,[],{},1.0,1e-7,0.1]},"topic":"/chatter","op":"publish","id":"last"}',
]
# One of each kind; the validator's tests have the others.
REFUSED = [
    "",
    "{}",
    '{"op":"robotether.go","id":7}',
    '{"op":"subscribe","topic":"/a b","id":"x"}',
    '{"op":"call_service","service":"/rosapi/set_param"}',
    '{"op":"publish","topic":"/cmd_vel","msg":{"x":1}}',
    '{"op":"publish","topic":"/cmd_vel","msg":{"linear":{"x":1}},"robotether":{"t_ms":-1e9}}',
    '{"op":"publish","topic":"/cmd_vel","robotether":{"t_ms":1e15}}',
]
LIMITED = {
    "the second subscription": ['{"op":"subscribe","topic":"/a","id":1}', '{"op":"subscribe","topic":"/b"}'],
    "a message over 4 KB": ['{"op":"publish","x":"' + "x" * 4096 + '"}'],
    "a message of many values": ['{"op":"publish","x":[' + "1," * 1800 + "1]}"],
    "many messages at once": ['{"op":"unsubscribe","topic":"/a"}'] * 50,
}  # fmt: skip
AGE = re.compile(r"\d+ ms old")


async def test_what_is_refused(world, recorded):
    """How the relay writes messages anew, and the status of each message that goes no further."""
    transcript, robot = Transcript(), await world.robot()
    for text, (what, got) in zip(WRITTEN, await outcomes(world, robot, WRITTEN, CARL), strict=True):
        transcript.add("client:", text)
        transcript.add(f"  {what}:", got)
    for text in REFUSED:
        ((what, answer),) = await outcomes(world, robot, [text])
        transcript.add("client:", text)
        transcript.add(f"  {what}:", AGE.sub("<age> ms old", answer))
    async with world.connect() as socket:
        await socket.send_bytes(bytes(range(256)))
        transcript.add("client, bytes that are no UTF-8:", await socket.receive_json())
    limits = Limits(subscriptions=1, messages_per_s=1, message_kb=4)
    await world.change(policy=structs.replace(world.sim1.settings.policy, limits=limits))
    for case, texts in LIMITED.items():
        async with world.connect() as socket:
            for text in texts:
                await socket.send_str(text)
            async with asyncio.timeout(WAIT_S):
                while (answer := await socket.receive_json())["op"] != "status":
                    pass
            transcript.add(f"{case}:", answer)
    assert transcript == recorded


async def test_relay_and_robot(world, recorded):
    """The handshake, a drive command as text with and without a guard, and what passes back as it is."""
    transcript = Transcript(MEASURED)
    transcript.name(world.sim1.ros_port or 0, "ros port")
    varying = {"User-Agent": "<aiohttp>", "Sec-WebSocket-Key": "<random>"}
    modes = ("guarded", "guard_off")
    for robot_mode in modes:
        robot = await world.robot(robot_mode)
        transcript.name(robot.session.configs[-1]["guard"]["key"], "guard's key")
        for number, (mode, user) in enumerate((("observe", BOB), ("drive", ANN)), 1):
            async with world.connect(mode, user) as socket:
                headers = (await robot.connections(number))[-1]
                shown = {name: varying.get(name, value) for name, value in headers.items()}
                transcript.add(
                    f"{user.name} of sim1, which is {robot_mode}:",
                    *(f"{name}: {value}" for name, value in sorted(shown.items())),
                )
                if mode == "observe":
                    continue
                for stamp in ({}, {"robotether": {"t_ms": 0}}):
                    message = {"op": "publish", "topic": "/cmd_vel", "id": "p", **stamp}
                    if stamp:
                        await socket.send_json({"op": "robotether.clock_sync", "t_ms": 0})
                        sync = await socket.receive_json(timeout=WAIT_S)
                        message["robotether"] = {"t_ms": sync["relay_ms"]}
                    await socket.send_json({**message, "msg": {"linear": {"x": 1, "y": 0.5}}})
                    expected = 2 if stamp else 1
                    await until(lambda r=robot, n=expected: len(r.received) == n, "it came", WAIT_S)
                    text = re.sub(r"\b\d+\.\d{3},", "<ms, 3 digits>,", str(robot.received[-1]))
                    transcript.add(f"{'with' if stamp else 'without'} a client's time:", text)
                    if not stamp:
                        await socket.receive_str()
        if robot_mode == "guarded":
            await robot.stop()
    async with world.connect("observe", BOB) as socket:
        await until(lambda: robot.clients, "the operator has reached rosbridge", WAIT_S)
        for data in (b'{"op": "publish",  "topic": "/a", "msg": {"x": NaN}}', b"no JSON", b""):
            await robot.send_to_clients(data)
            message = await asyncio.wait_for(socket.receive(), WAIT_S)
            transcript.add(f"from the robot, {message.type.name}:", json.dumps(message.data))
        for client in robot.clients:
            await client.send_bytes(b"\x00\x01bson\xff")
        message = await asyncio.wait_for(socket.receive(), WAIT_S)
        transcript.add(f"from the robot, {message.type.name}:", message.data.hex(" "))
    assert transcript == recorded


async def test_own_operations(world, recorded):
    """Clock syncs, the control object in each of its states, and a stop from an observer."""
    transcript, robot = Transcript(["relay_ms"]), await world.robot()
    async with AsyncExitStack() as stack:
        bob = await stack.enter_async_context(world.connect("observe", BOB))

        async def add(state, condition):
            async with asyncio.timeout(WAIT_S):
                while True:
                    message = await bob.receive_json()
                    if message["op"] == "robotether.control" and condition(message["control"]):
                        break
            as_before, changes = transcript.changes(message)
            transcript.add(f"{state}{as_before}:", changes)

        await bob.send_str('{"op":"robotether.clock_sync","t_ms":81.25,"key":"k1","x":1}')
        transcript.add("clock sync:", await bob.receive_json(timeout=WAIT_S))
        await add("nobody drives", lambda c: not c["driver"])
        await stack.enter_async_context(world.connect())
        await add("ann drives", lambda c: c["driver"])
        await world.ask(CARL, "lease", action="ask")
        await add("carl asks", lambda c: c["waiting"] and c["waiting"]["passes_at"])
        await world.ask(ANN, "lease", action="hand_over")
        await add("it is kept for carl", lambda c: c["reserved"])
        await stack.enter_async_context(world.connect("drive", CARL))
        await add("carl drives", lambda c: c["driver"])
        robot.session.answers_orders = False
        await bob.send_str('{"op":"robotether.stop","x":1}')
        await add("bob has stopped it", lambda c: c["stopped"] and not c["stopped"]["confirmed"])
        robot.session.answers_orders = True
        await add("its guard has the stop", lambda c: c["stopped"] and c["stopped"]["confirmed"])
        await world.ask(ANN, "release")
        await add("ann has released it", lambda c: not c["stopped"])
        robot.session.send(type="guard", state="down", stopped=False, by="", moving=False,
                           answers=None, refused={})  # fmt: skip
        await add("its guard is down", lambda c: c["guard"] == "down")
        await robot.stop()
        await add("it is offline", lambda c: c["guard"] not in {"down", "ready"})
    assert robot.received == []
    assert transcript == recorded


class Ends:
    """Opens connections that end, and adds how to a transcript."""

    def __init__(self, world):
        self.world = world
        self.transcript = Transcript()
        self.robot = None

    async def add(self, case, act=lambda _: None, mode="drive", user=ANN):
        """Have a connection ended by `act`, once it has reached the robot if there is one that lets it."""
        before = 0 if self.robot is None else self.robot.clients_ever
        async with self.world.connect(mode, user) as socket:
            if (robot := self.robot) is not None:
                await until(lambda: robot.clients_ever > before, "rosbridge is reached", WAIT_S)
            done = act(socket)
            if done is not None:
                await done
            await self.add_end(case, socket)
        connections = self.world.relay.relay.connections
        await until(lambda: not connections.count(mode), "it has left", WAIT_S)

    async def add_refused(self, case, user=ANN):
        """Have a connection that does not reach the robot."""
        async with self.world.connect("drive", user) as socket:
            await self.add_end(case, socket)

    async def add_end(self, case, socket):
        self.transcript.add(f"{case}:", await ending_of(socket))

    async def online(self):
        self.robot = await self.world.robot()
        return self.robot


async def ending_of(socket):
    code, reason = await closing(socket)
    return f"{code} {reason}"


def announced(size):
    """Announce a message of this size to the relay."""
    header = b"\x81\xff" + struct.pack("!Q", size)
    return lambda socket: socket._writer.transport.write(header)


async def test_how_connections_end(world, recorded):
    """The close code and reason of each end."""
    ends = Ends(world)
    await ends.add("never connected")
    await _ends_by_messages(ends)
    await _ends_by_rights(ends)
    await _ends_by_robot(ends)
    assert ends.transcript == recorded


async def _ends_by_messages(ends):
    robot = await ends.online()

    def by_robot(data):
        def write(_):
            for client in robot.clients:
                client._req.transport.write(data)

        return write

    def no_websocket(socket):
        socket._writer.transport.write(b"\xff\xff\xff\xff")

    goodbye = struct.pack("!H", 1000)
    await ends.add("client leaves", lambda s: s.send_frame(goodbye, WSMsgType.CLOSE))
    await ends.add("over an observer's limit", announced(65 * 1024), "observe", BOB)
    await ends.add("over a driver's limit", announced(11 * 2**20))
    await ends.add("robot over its limit", by_robot(b"\x81\x7f" + struct.pack("!Q", 2**24)))
    await ends.add("no WebSocket", no_websocket)
    await ends.add("no WebSocket from the robot", by_robot(b"\xff\xff"))


async def set_guard(ends, guard):
    """Have the agent say so, and wait until the relay knows."""
    registry = ends.world.relay.relay.registry
    ends.robot.session.send(type="hello", hostname="turtle", agent_version="0.1.0", guard=guard)
    await until(lambda: registry.presence(7).guard_mode == guard, f"the guard is {guard}", WAIT_S)


async def _ends_by_rights(ends):
    world, database, relay = ends.world, ends.world.database, ends.world.relay.relay

    def broken(_):
        raise RuntimeError("a defect of the test's own")

    async def to_carl(_):
        await world.ask(CARL, "lease", action="ask")
        await world.ask(ANN, "lease", action="hand_over")

    grants = dict(database.grants)
    await ends.add("rights ended", lambda _: database.grants.clear())
    database.grants |= grants
    await relay.fleet.poll()
    usual = relay.connections.caps
    relay.connections.caps = replace(usual, per_user=0)
    await ends.add_refused("too many of a user")
    relay.connections.caps = usual
    # With a guard the lease would begin all the same.
    await set_guard(ends, "off")
    database.down = True
    await ends.add_refused("no database")
    database.down = False
    await set_guard(ends, "on")
    await relay.fleet.poll()
    database.next_fence = broken
    await ends.add_refused("a defect of the relay")
    del database.next_fence
    async with world.connect() as socket:
        await until(lambda: relay.control.driver(7), "ann drives", WAIT_S)
        async with world.connect():
            await ends.add_end("superseded", socket)
            await ends.add_refused("held by another", CARL)
    await until(lambda: not relay.connections.count("drive"), "all have left", WAIT_S)
    await ends.add("handed over", to_carl)
    await ends.add_refused("kept for another")
    await ends.add("stopped", lambda _: world.ask(BOB, "stop"), user=CARL)
    await ends.add_refused("still stopped")
    await world.ask(ANN, "release")


async def _ends_by_robot(ends):
    robot, relay = ends.robot, ends.world.relay.relay
    await ends.add("rosbridge ends", lambda _: next(iter(robot.clients)).close())
    await ends.add("rosbridge breaks", lambda _: next(iter(robot.clients))._req.transport.abort())
    robot.mode = "port_taken"
    await ends.add("link lost", lambda _: robot.session.close())
    await robot.stop()
    ends.robot = None
    await ends.add("offline")
    other = await ends.world.robot("no_rosbridge")
    await ends.add("no rosbridge")
    await other.stop()
    await ends.online()
    stopping = []
    stop = relay.stop
    await ends.add("relay stops", lambda _: stopping.append(asyncio.create_task(stop())))
    await stopping[0]


async def test_how_slow_connections_end(open_world, patient, recorded, monkeypatch):
    """Who says nothing or far too much, and a robot that takes nothing; of all limits only this one is short."""
    transcript, short_s = Transcript(), 0.5
    driver_limits = replace(patient.driver_limits, silent_after_s=short_s)
    async with open_world(replace(patient, driver_limits=driver_limits)) as world:
        await world.robot()
        async with world.connect(autoping=False) as socket:
            transcript.add("client says nothing:", await ending_of(socket))
    driver_limits = replace(patient.driver_limits, slow_after_s=short_s)
    async with open_world(replace(patient, driver_limits=driver_limits)) as world:
        await world.robot("slow_reader")
        async with world.connect("drive", CARL) as socket:
            large = {"op": "publish", "topic": "/chatter", "msg": {"x": "x" * 500_000}}
            transcript.add("robot takes nothing:", await _end_of_sender(socket, large))
    monkeypatch.setattr(message_validator, "FLOOD_AFTER_S", short_s)
    async with open_world(patient) as world:
        await world.robot()
        async with world.connect("observe", BOB) as socket:
            large = {"op": "subscribe", "topic": "/a", "x": "x" * 30_000}
            transcript.add("client floods:", await _end_of_sender(socket, large))
    assert transcript == recorded


async def _end_of_sender(socket, message):
    """Send a message as often as it is taken, until the relay closes."""

    async def send():
        with suppress(ConnectionError):
            while not socket.closed:
                await socket.send_json(message)
                await asyncio.sleep(0)

    sending = asyncio.create_task(send())
    found = await ending_of(socket)
    await sending
    return found


async def test_what_opens_nothing(world, recorded):
    """The answer of HTTP to a handshake that is refused before the upgrade; the handler's tests have each ticket."""
    transcript, relay = Transcript(), world.relay
    base, good = f"{relay.url}/robots/sim1/ros", relay.ticket(world.sim1)
    kept = ("Content-Type", "Cache-Control", "WWW-Authenticate", "X-Content-Type-Options")
    for case, url, sent in (
        ("without a ticket", base, UPGRADE),
        ("another site", f"{base}?ticket={good}", UPGRADE | {"Origin": "https://evil.example"}),
        ("no upgrade", f"{base}?ticket={good}", {}),
    ):
        async with world.http.get(url, headers=sent) as answer:
            shown = {name: answer.headers[name] for name in kept if name in answer.headers}
            problem = problem_line(answer.status, await answer.json(content_type=None))
            transcript.add(f"{case}: {answer.status}", shown, problem)
    assert transcript == recorded
