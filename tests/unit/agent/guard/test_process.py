"""The guard as a process, before the simulated robot's own rosbridge and before one that misbehaves."""

import asyncio
import json
import os
import signal
import threading
import time
from contextlib import asynccontextmanager

import aiohttp
import pytest
from fake_pipe import FakePipe
from guard_process import WAIT_S, GuardClient, GuardHere, GuardProcess
from robotether_agent.clock import robot_time
from robotether_agent.guard.agent_messages import GuardReporter
from robotether_agent.guard.latch import StopFile
from robotether_agent.guard.process import Guard
from robotether_agent.rosbridge_socket import new_http
from sim_client import SETTINGS, until
from sim_robot.graph import Node
from sim_robot.simulator import Simulator

DEADMAN_S = 0.5
# Where something else than the deadman has to stop the robot: the longest that a guard takes. To the millisecond the
# deadman is tested with a given clock (test_deadman), and how long it takes in all is in benchmarks/stopping.py.
LATE_DEADMAN_MS = 2000


class Robot:
    def __init__(self, simulator):
        self.port = simulator.rosbridge.port
        self.commands = []
        bus = simulator.graph.bus
        bus.subscribe("/cmd_vel", "geometry_msgs/Twist", Node("/wheels"), self._receive)

    def _receive(self, message):
        self.commands.append((time.monotonic(), message.values["linear"]["x"]))

    @property
    def speeds(self):
        return [speed for _, speed in self.commands]

    def zero_after(self, since):
        """Seconds from a moment to the first zero after it."""
        return next(at for at, speed in self.commands if speed == 0 and at >= since) - since

    @property
    def stopped_before_deadman(self):
        """Whether the first zero came well before the deadman's, which counts from a bit before the last motion."""
        first = self.speeds.index(0.0)
        return self.commands[first][0] - self.commands[first - 1][0] < LATE_DEADMAN_MS / 1000 - 0.1


@pytest.fixture
async def robot():
    async with Simulator(SETTINGS) as simulator:
        yield Robot(simulator)


@asynccontextmanager
async def driven(place, robot, **options):
    """A guard, and the client that holds its lease."""
    async with GuardHere(place, robot.port, **options) as guard:
        await guard.grant(13)
        async with GuardClient(guard.port, 13) as client:
            yield guard, client


async def drive_on(client, seconds=0.3):
    end = time.monotonic() + seconds
    while True:
        await client.drive(0.5)
        sent_at = time.monotonic()
        if sent_at > end:
            return sent_at
        await asyncio.sleep(0.05)


def refusals(guard):
    return guard.state["refused"]


async def test_a_robot_stops_when_commands_stop(place, robot):
    """Ten zeros follow after the deadman time, then silence; the connection stays open. Commands are limited."""
    async with driven(place, robot, max_speed_m_s=0.2) as (guard, client):
        last = await drive_on(client)
        await until("ten zeros came", lambda: robot.speeds.count(0.0) == 10)
        assert robot.zero_after(last) >= DEADMAN_S - 0.05
        assert set(robot.speeds) == {0.2, 0.0}
        await guard.until(lambda: not guard.state["moving"], "it stands")
        await client.send(op="call_service", service="/rosapi/get_time", id="x")
        assert (await client.receive())["id"] == "x"
        await guard.until(lambda: not (place / "motion.json").exists(), "the mark is gone")
        assert robot.speeds.count(0.0) == 10


async def test_a_topic_that_drives_no_more_stops(place, robot):
    """Settings that change in motion: what the server still stamps is refused, and the robot gets its zeros."""
    async with driven(place, robot) as (guard, client):
        await client.drive(0.5)
        await until("it moves", lambda: robot.speeds == [0.5])
        guard.reconfigure(guard={**guard.config["guard"], "drive_topics": ["/base/move"]})
        await guard.heard()
        async with asyncio.timeout(WAIT_S):
            while 0.0 not in robot.speeds:
                await drive_on(client, 0.1)
        assert robot.speeds.count(0.5) == 1
        await guard.heard()
        assert refusals(guard)["shape"] > 0


LOSSES = {
    "connection": lambda _, client: client.socket._response.close(),
    "lease": lambda guard, _: guard.tell(type="lease", fence=13, held=False),
    "newer lease": lambda guard, _: guard.tell(type="lease", fence=14, held=True),
    "stop": lambda guard, _: guard.tell(type="stop", id="5f", by="ben"),
    "session": lambda guard, _: guard.tell(type="session", up=False),
}
ENDS = {
    "end of input": lambda guard: guard.leave(),
    "exit": lambda guard: guard.tell(type="exit"),
    "SIGTERM": lambda guard: guard.process.send_signal(signal.SIGTERM),
}


@pytest.mark.parametrize("loss", LOSSES)
async def test_each_loss_stops_the_robot(place, robot, loss):
    """At once, well before the deadman time would, and whoever may not drive any more is put out."""
    async with driven(place, robot, deadman_ms=LATE_DEADMAN_MS) as (guard, client):
        await drive_on(client)
        LOSSES[loss](guard, client)
        assert loss == "connection" or await client.closed() == 1001
        await until("ten zeros came", lambda: robot.speeds.count(0.0) == 10)
        assert robot.stopped_before_deadman


@pytest.mark.parametrize("end", ENDS)
async def test_each_end_of_the_guard_stops_the_robot(place, robot, end):
    async with GuardProcess(place, robot.port, deadman_ms=LATE_DEADMAN_MS) as guard:
        await guard.grant(13)
        async with GuardClient(guard.port, 13) as client:
            await drive_on(client)
            ENDS[end](guard)
            await until("ten zeros came", lambda: robot.speeds.count(0.0) == 10)
            assert robot.stopped_before_deadman
            assert await guard.ended() == 0
            assert not (place / "motion.json").exists()


async def test_a_log_that_nobody_reads_holds_up_no_stop(place, robot):
    """A journal or a container's log driver may hang; what would wait for it is dropped, and counted."""
    unread, full = os.pipe()
    with os.fdopen(unread, "rb", 0) as log, os.fdopen(full, "wb", 0) as stderr:
        guard = GuardProcess(place, robot.port)
        guard.stderr = stderr.fileno()
        async with guard:
            await guard.grant(13)
            os.set_blocking(full, False)
            while stderr.write(b"x" * 4096):
                pass
            os.set_blocking(full, True)
            async with GuardClient(guard.port, 13) as client:
                await drive_on(client)
                guard.tell(type="stop", id="5f", by="ben")
                await until("ten zeros came", lambda: robot.speeds.count(0.0) == 10)
            log.read(1 << 20)
            guard.tell(type="release", id="77", by="ann")
            await guard.until(lambda: guard.state["answers"] == "77", "it answers")
            assert b"messages" in log.read(1 << 20)


async def test_a_silent_agent_holds_the_robot(place, robot):
    """One second without a tick, and a driver who goes on drives nobody until the next one."""
    async with driven(place, robot, deadman_ms=LATE_DEADMAN_MS) as (guard, client):
        # Once: the deadman of a first command wakes the guard, which would find the silence by that, too.
        await client.drive(0.5)
        guard.silence()
        await until("it stands", lambda: 0.0 in robot.speeds)
        assert robot.stopped_before_deadman
        await client.drive(0.5)
        assert "agent" in (await client.receive())["msg"]
        guard.tell(type="tick")
        await guard.heard()
        await client.drive(0.7)
        await until("it drives again", lambda: 0.7 in robot.speeds)


async def test_a_stop_outlives_the_guard(place, robot):
    async with GuardProcess(place, robot.port) as guard:
        await guard.grant(13)
        guard.tell(type="stop", id="5f", by="ben")
        await guard.until(lambda: guard.state["answers"] == "5f", "it answers")
        assert json.loads((place / "stop.json").read_text()) == {"by": "ben"}
        guard.process.kill()
        await guard.ended()
    async with GuardHere(place, robot.port) as guard:
        assert (guard.state["stopped"], guard.state["by"]) == (True, "ben")
        await guard.grant(14)
        with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
            async with GuardClient(guard.port, 14):
                pass
        assert refused.value.status == 409
        guard.tell(type="release", id="77", by="ann")
        await guard.until(lambda: guard.state["answers"] == "77", "it answers")
        assert not guard.state["stopped"]
        assert not (place / "stop.json").exists()
        async with GuardClient(guard.port, 15) as client:
            await client.drive(0.5)
            await until("the robot moves", lambda: robot.speeds == [0.5])


async def test_a_stop_is_told_when_the_disk_has_it(tmp_path, monkeypatch):
    """Until then the robot is stopped, and the server does not count on it."""
    write, go = StopFile.write, threading.Event()
    monkeypatch.setattr(StopFile, "write", lambda file, by: go.wait(5) and write(file, by))
    async with new_http() as http:
        guard = Guard(http, tmp_path, tmp_path, GuardReporter(pipe := FakePipe()))
        disk = asyncio.create_task(guard._latch.run())
        guard._report_state()
        guard._on_line(b'{"type": "stop", "id": "5f", "by": "ben"}')
        guard._report_state()
        assert guard._authorizer.stopped
        assert [line["stopped"] for line in pipe.lines] == [False]
        go.set()
        await until("it is told", lambda: len(pipe.lines) == 2)
        report = {name: pipe.lines[-1][name] for name in ("stopped", "by", "answers")}
        assert report == {"stopped": True, "by": "ben", "answers": "5f"}
        assert StopFile(tmp_path).read() == "ben"
        disk.cancel()
        await asyncio.gather(disk, return_exceptions=True)


async def test_a_killed_guards_successor_stops_the_robot_and_knows_the_newest_lease(place, robot):
    """Even if nobody drives through it; nobody drives with that number, whatever the lease's line says."""
    async with GuardProcess(place, robot.port) as guard:
        await guard.grant(13)
        async with GuardClient(guard.port, 14) as client:
            await drive_on(client)
            guard.process.kill()
            await guard.ended()
    async with GuardHere(place, robot.port) as guard:
        assert guard.state["fence"] == 14
        await until("ten zeros came", lambda: robot.speeds.count(0.0) == 10)
        await guard.until(lambda: not (place / "motion.json").exists(), "the mark is gone")
        for fence in (13, 14):
            await guard.grant(fence)
            with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
                async with GuardClient(guard.port, fence):
                    pass
            assert refused.value.status == 409
        async with GuardClient(guard.port, 15):
            await guard.until(lambda: guard.state["fence"] == 15, "it reports the next one")


def seen_by(guard):
    return [age for line in guard.lines if line["type"] == "seen" for age in line["ages_ms"]]


async def test_the_guard_reports_how_old_is_what_the_driver_sees(place, robot):
    """The age counts from the frame's time to the command, by the robot's clock."""
    async with driven(place, robot) as (guard, client):
        taken_ms = robot_time() * 1000 - 300
        guard.tell(type="frame", camera="/a", frame=41, taken_ms=taken_ms)
        await guard.heard()
        stamp = {"t_ms": robot_time() * 1000, "fence": 13}
        await client.drive(0.5, robotether=stamp | {"seen": [{"camera": "/a", "frame": 41}]})
        await guard.until(lambda: bool(seen_by(guard)), "it is reported")
        [age_ms] = seen_by(guard)
        assert 300 <= age_ms <= robot_time() * 1000 - taken_ms


async def test_direct_connections_drive_while_nobody_has_the_lease(place, robot):
    """They need neither key nor stamps, and lose the robot to a driver of the server."""
    async with GuardHere(place, robot.port, deadman_ms=LATE_DEADMAN_MS) as guard:
        guard.reconfigure(direct=True)
        guard.tell(type="session", up=True)
        await guard.heard()
        async with GuardClient(guard.port, None) as client:
            await client.drive(0.5, robotether=None)
            await until("the robot moves", lambda: robot.speeds == [0.5])
            guard.tell(type="lease", fence=1, held=True)
            await until("the robot stands", lambda: robot.speeds[-1] == 0.0)
            assert robot.stopped_before_deadman
            await client.drive(0.5)
            assert (await client.receive())["op"] == "status"
    # No handshake brought the number: the line of the lease did.
    assert json.loads((place / "fence.json").read_text()) == {"fence": 1}


async def test_broken_lines_of_the_agent_do_no_harm(place, robot):
    async with GuardHere(place, robot.port) as guard:
        guard.write(b"rubbish\n{}\n" + b"x" * 200_000 + b"\n")
        guard.reconfigure(guard={"deadman_ms": 3})
        await guard.grant(13)
        async with GuardClient(guard.port, 13) as client:
            await client.drive(0.5)
            await until("the robot moves", lambda: robot.speeds == [0.5])
