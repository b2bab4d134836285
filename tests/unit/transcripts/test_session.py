"""The lines of a robot's session in both directions, as agent and relay write them.

The agent is the real program with its guard, and OpenSSH carries its lines to the real relay. Only the session
command is a double; its first line is read from the real one's source.
"""

import asyncio
import shutil
import socket
import tempfile
from dataclasses import replace
from pathlib import Path

import aiohttp
import pytest
from fake_cameras import FakeVideoServer
from fake_cloud import agent_environ, eventually
from fake_robot import HOST, RobotSession
from fake_rosbridge import FakeRosbridge
from recording_server import RecordingServer, running_agent
from relay_server import SESSION_KEY, MemoryDatabase, running_relay
from robotether_server.db.fleet import RelayUser
from transcripts import Transcript

TOPICS = {
    "/battery_state": "sensor_msgs/msg/BatteryState",
    "/camera/image_raw": "sensor_msgs/msg/Image",
}
WAIT_S = 60.0


class Session:
    """One agent at a server: waits for lines, and writes each down that was waited for."""

    def __init__(self, server, relay, database):
        self.server, self.relay, self.database = server, relay, database
        self.transcript = Transcript(measured=["t_ms", "seq", "epoch"])
        self.transcript.name(socket.gethostname(), "hostname")
        for port, name in zip(server.ports, ("ROS port", "video port"), strict=True):
            self.transcript.name(port, name)
        self._from = 0

    async def line(self, who, kind, of="session", **members):
        """Wait for a line of this type with these members since the last thing that happened."""

        def found():
            lines = [said for *side, said in self.server.said[self._from :] if side == [of, who]]
            return [
                said for said in lines if said["type"] == kind and members.items() <= said.items()
            ]

        await eventually(
            lambda: bool(found()), lambda: f"{who} {kind} {members}: {self.server.said}", WAIT_S
        )
        said = found()[0]
        if kind == "hello":
            self.transcript.name(said["agent_version"], "version")
        as_before, changes = self.transcript.changes(said)
        self.transcript.add(f"{who} ({of}){as_before}:", changes)
        return said

    def happens(self, what):
        """Note what happens now; only lines after it are waited for."""
        self.transcript.add(f"--- {what}")
        self._from = len(self.server.said)

    async def change(self, **changes):
        robots = self.database.robots
        self.database.robots = {7: replace(robots[7], **changes)}
        await self.relay.relay.fleet.poll()


@pytest.fixture
async def session(patient):
    """An agent whose robot is well, at a relay on which user 1 drives it."""
    database = MemoryDatabase()
    robot = database.add_robot(7, "sim1", u1="drive")
    async with (
        running_relay(database, patient) as relay,
        FakeRosbridge(TOPICS) as rosbridge,
        FakeVideoServer() as video,
    ):
        server = RecordingServer(relay, robot.id)
        server.ports = (robot.ros_port, robot.video_port)
        await server.start()
        urls = {"rosbridge_url": rosbridge.url, "video_url": video.url}
        place = Path(
            tempfile.mkdtemp(prefix="rt-")
        )  # a Unix socket's path is at most 107 bytes long
        try:
            async with running_agent(agent_environ(server, place, **urls)):
                session = Session(server, relay, database)
                await battery(rosbridge)
                await call_for_help(rosbridge)
                yield session
        finally:
            await server.close()
            shutil.rmtree(place)


async def battery(rosbridge):
    """Have the robot say how full its battery is, as soon as somebody wants to know."""
    await rosbridge.subscription("/battery_state")
    await rosbridge.publish(
        "/battery_state", {"percentage": 0.81, "voltage": 24.1, "power_supply_status": 1}
    )


async def call_for_help(rosbridge):
    """Have a program on the robot ask for a person."""
    await rosbridge.subscription("/robotether/help")
    await rosbridge.publish("/robotether/help", {"data": "I need a person"})


async def test_session(session, recorded):
    """It has each type of line in both directions, from the first line to the bye."""
    relay, line = session.relay, session.line
    await line("session command", "preface")
    await line("relay", "config")
    await line("relay", "lease")
    await line("agent", "hello")
    await line("agent", "health", ros="ok", video="ok")
    await line("agent", "guard", state="ready")
    await line("agent", "vitals")
    await line("agent", "help")
    await line("agent", "ping")
    await line("relay", "pong")
    await line("relay", "ping")
    await line("agent", "pong")
    await line("agent", "check")
    await line("relay", "checked", ros="ok", video="unknown")
    robot = session.database.robots[7]
    token = session.database.add_credential("token", RelayUser(1, "ann"))
    connector = aiohttp.TCPConnector(force_close=True)
    async with aiohttp.ClientSession(
        connector=connector, headers={"Authorization": f"Bearer {token}"}
    ) as http:
        session.happens("ann looks at the fleet page")
        async with http.get(f"{relay.url}/robots/sim1/video/robotether/snapshot") as answer:
            assert (answer.status, answer.content_type) == (200, "image/jpeg")
        await line("relay", "config", media=True)
        await line("session command", "preface", "media")
        await line("relay", "config", "media")
        await line("agent", "ping", "media")
        await line("relay", "pong", "media")
        await line("relay", "checked", ros="ok", video="ok")
        session.happens("ann drives")
        async with http.ws_connect(relay.ros_url(robot)):
            await line("relay", "lease", held=True)
            session.happens("ann stops driving")
        await line("relay", "lease", held=False)
        for order, stopped in (("stop", True), ("release", False)):
            session.happens(f"ann asks for {order}")
            async with http.post(f"{relay.url}/api/v1/robots/sim1/{order}") as answer:
                assert answer.status == 200
            message = await line("relay", order)
            await line("agent", "guard", stopped=stopped, answers=message["id"])
    session.happens("an admin asks for a new name")
    await session.change(name="turtle")
    await line("relay", "config")
    session.happens("an admin disables the robot")
    await session.change(state="disabled")
    await line("relay", "bye")
    await line("relay", "bye", "media")
    assert session.transcript == recorded


async def connected(relay, **given):
    """Open a connection to the session port, as the session command does."""
    fields = {"robot_id": 7, "kind": "session", "session_key": SESSION_KEY} | given
    session = RobotSession(fields.pop("robot_id"), **fields)
    await session.connect(relay.relay.session_port)
    return session


async def ended(session):
    """Wait for the end, and return the bye."""
    await asyncio.wait_for(session.closed.wait(), WAIT_S)
    await session.close()
    return session.bye


async def test_byes(patient, recorded):
    """What the relay says to who may not connect, does not keep to the protocol, or has to go."""
    database = MemoryDatabase()
    robot = database.add_robot(7, "sim1")
    transcript = Transcript()
    transcript.name(robot.ros_port, "ROS port")
    async with running_relay(database, patient) as relay:

        async def add(what, data=b"", **given):
            session = await connected(relay, **given)
            session.send_raw(data)
            transcript.add(f"{what}:", await ended(session))

        await add("another session key", session_key="wrong")
        await add("another kind", kind="party")
        await add("an unknown robot", robot_id=8)
        await add("another key", fingerprint="SHA256:other")
        await add("a shell that is off", kind="shell")
        await add("other ports", ports=(1,))
        for line in (b"no JSON", b'{"type": "ping"}'):
            await add(line.decode(), line + b"\n")
        # No byte more than the relay has to read: it would be gone before its bye arrives.
        await add("a line over 64 KiB", b"x" * (64 * 1024 + 1))
        older = await connected(relay)
        await older.wait_configured()
        newer = await connected(relay)
        transcript.add("a newer session:", await ended(older))
        await newer.close()
        holder = await asyncio.start_server(lambda _r, w: w.close(), HOST, robot.ros_port)
        await add("a port that somebody holds")
        holder.close()
        database.robots = {7: replace(robot, state="disabled")}
        await relay.relay.fleet.poll()
        await add("a disabled robot")
        database.robots = {7: robot}
        await relay.relay.fleet.poll()
        last = await connected(relay, kind="media")
        await last.wait_configured()
    transcript.add("a relay that stops:", await ended(last))
    async with running_relay(database, replace(patient, timeout_s=0.5)) as relay:
        silent = await connected(relay, silent=True)
        transcript.add("a robot that answers no ping:", await ended(silent))
    assert transcript == recorded
