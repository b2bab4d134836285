"""Whatever is cut comes back by itself, and what need not notice does not."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from contextlib import suppress
from http.client import HTTPException
from socket import create_connection

import pytest
from docker.models.containers import Container
from inside import run_inside
from programs import Program, drive_on, echo, open_echo
from stack import Stack, wait_until_back


@pytest.fixture(scope="module")
def program(stack: Stack) -> Iterator[Program]:
    """A program with an API token of the admin; afterwards all robots are back for the tests that follow."""
    yield Program(stack, stack.token("recovery"))
    wait_until_back(stack, "sim1", "sim2", "sim3")


def _wait_restarted(stack: Stack, service: str, before: Container, seconds: float = 30) -> None:
    count = before.attrs["RestartCount"]
    stack.wait(
        f"{service} restarted",
        lambda: stack.container(service).attrs["RestartCount"] > count,
        service,
        seconds=seconds,
    )


async def _drivable(program: Program, robot: str) -> bool:
    try:
        async with asyncio.timeout(5), program.connect(robot) as socket:
            await open_echo(socket)
            return await echo(socket, "back") == "back"
    except (OSError, TimeoutError, AssertionError, TypeError, RuntimeError, HTTPException):
        return False
    except Exception as error:  # aiohttp's tree has no common base for "not now"
        if type(error).__module__.startswith("aiohttp"):
            return False
        raise


async def _wait_drivable(program: Program, robot: str, seconds: float = 40) -> float:
    started = time.monotonic()
    while not await _drivable(program, robot):
        if time.monotonic() - started > seconds:
            logs = await asyncio.to_thread(program.stack.logs, robot, "sshd", "relay")
            raise AssertionError(f"{robot} is not drivable after {seconds} s\n{logs}")
        await asyncio.sleep(0.2)
    return time.monotonic() - started


async def test_robot_restarted_comes_back(program: Program, stack: Stack) -> None:
    """A robot that is switched off and on is drivable again without anybody's help."""
    await asyncio.to_thread(stack.container("sim2").restart, timeout=5)
    await _wait_drivable(program, "sim2")


async def test_robot_cut_off_without_a_word_comes_back(program: Program, stack: Stack) -> None:
    """A robot whose container is killed leaves a dead tunnel behind, which does not hold its ports."""
    sim = stack.container("sim2")
    await asyncio.to_thread(sim.kill)
    await asyncio.to_thread(sim.start)
    await _wait_drivable(program, "sim2")


async def test_killed_session_comes_back(program: Program, stack: Stack) -> None:
    """When the robots' sshd processes on the server are killed every robot reconnects."""
    by_owner = (
        "for p in /proc/[0-9]*; do [ $(stat -c %U $p) = tunnel ] && kill -9 ${p#/proc/}; done"
    )
    done = await asyncio.to_thread(run_inside, stack.container("sshd"), "bash", "-c", by_owner)
    assert "Operation not permitted" not in done.stderr
    for robot in ("sim1", "sim2", "sim3"):
        await _wait_drivable(program, robot)


@pytest.mark.parametrize("service", ["relay", "sshd", "nginx", "web"])
async def test_service_killed_comes_back(program: Program, stack: Stack, service: str) -> None:
    """A service that dies is restarted by the engine and the robots are drivable again."""
    container = stack.container(service)
    # A kill by the engine counts as a stop that was wanted; the process must die by itself to be restarted.
    # Not by the engine's SDK, which then asks how the command ended: the engine forgets that with the container's end.
    await asyncio.to_thread(run_inside, container, "bash", "-c", "kill -9 -1")
    await asyncio.to_thread(_wait_restarted, stack, service, container)
    await asyncio.to_thread(stack.wait_healthy, service)
    await _wait_drivable(program, "sim1")


def _signal_all(container: Container, name: str) -> None:
    run_inside(container, "bash", "-c", f"kill -{name} -1")


async def test_health_says_from_outside_what_hangs(program: Program, stack: Stack) -> None:
    """Nothing is ended yet: a stopped relay and database go on, and the robot is drivable again."""
    for service in ("relay", "mysql"):
        container = stack.container(service)
        await asyncio.to_thread(_signal_all, container, "STOP")
        try:
            status, _ = await asyncio.to_thread(stack.request, "GET", "/healthz")
        finally:
            await asyncio.to_thread(_signal_all, container, "CONT")
        assert status == 503, service
    await asyncio.to_thread(
        stack.wait, "good health", lambda: stack.request("GET", "/healthz") == (200, "ok\n"), "web"
    )
    await _wait_drivable(program, "sim1")


async def test_log_ins_through_443_come_back(stack: Stack) -> None:
    """The killed master of sshd's nginx leaves no worker that keeps its port from the next one."""
    kill_master = "kill -KILL $(cat /run/robotether/proxy-protocol/nginx.pid)"
    await asyncio.to_thread(run_inside, stack.container("sshd"), "bash", "-c", kill_master)

    def answers() -> bool:
        with suppress(OSError), create_connection(("localhost", stack.https_port), 5) as ssh:
            ssh.sendall(b"SSH-2.0-test\r\n")
            return ssh.recv(8) == b"SSH-2.0-"
        return False

    await asyncio.to_thread(stack.wait, "SSH at 443", answers, "sshd")
    assert "Address already in use" not in await asyncio.to_thread(stack.logs, "sshd")


@pytest.mark.release
async def test_services_that_hang_come_back(program: Program, stack: Stack) -> None:
    """Services that are stopped are ended, and begin anew."""
    hung = {service: stack.container(service) for service in ("relay", "web", "nginx", "mysql")}
    for container in hung.values():
        await asyncio.to_thread(_signal_all, container, "STOP")
    for service, container in hung.items():
        await asyncio.to_thread(_wait_restarted, stack, service, container, 120)
        await asyncio.to_thread(stack.wait_healthy, service)
    for robot in ("sim1", "sim2", "sim3"):
        await _wait_drivable(program, robot)


async def test_whole_server_restarted_comes_back(program: Program, stack: Stack) -> None:
    """After a restart of all services every robot is drivable again."""
    await asyncio.to_thread(stack.compose, "restart", "--timeout", "5", timeout=180)
    await asyncio.to_thread(stack.wait_healthy, "web")
    await asyncio.to_thread(stack.wait_healthy, "nginx")
    for robot in ("sim1", "sim2", "sim3"):
        await _wait_drivable(program, robot, seconds=60)


async def test_driving_goes_on_and_begins_without_the_database(
    program: Program, stack: Stack
) -> None:
    """A stopped mysql is not noticed by tunnels and open drive connections, nor by who drove shortly before."""
    mysql = stack.container("mysql")
    newcomer = Program(stack, await asyncio.to_thread(stack.token, "newcomer"))
    try:
        async with newcomer.connect("sim1") as socket:
            await open_echo(socket)
            # Its lease is in the database by then, which the next lines take away.
            assert await echo(socket, "driving") == "driving"
            await drive_on(socket, asyncio.to_thread(mysql.stop, timeout=20))
            # Longer than the relay waits for an answer, and than a driver lasts of whom nothing comes.
            await drive_on(socket, asyncio.sleep(5))
        async with newcomer.connect("sim1") as socket:
            await open_echo(socket)
            assert await echo(socket, "driving again") == "driving again"
        # One that this token has never opened.
        async with newcomer.connect("sim2") as socket:
            await open_echo(socket)
            assert await echo(socket, "driving another") == "driving another"
            # This takes seconds on a busy machine, in which a driver who reads nothing is gone.
            await drive_on(socket, asyncio.to_thread(mysql.start))
            await drive_on(socket, asyncio.to_thread(stack.wait_healthy, "mysql"))
            assert await echo(socket, "and on") == "and on"
    finally:
        await asyncio.to_thread(mysql.start)
        await asyncio.to_thread(stack.wait_healthy, "mysql")
    await _wait_drivable(program, "sim1")


async def test_drive_without_the_database_outlives_its_relay(
    program: Program, stack: Stack
) -> None:
    """Its record is on the relay's disk; the next relay writes it when the database is back."""
    await _wait_drivable(program, "sim1")
    newest = "FROM control_leases JOIN robots ON robots.id = robot_id WHERE name = 'sim1'"
    [[fence]] = await asyncio.to_thread(stack.sql, f"SELECT fence + 1 {newest}")
    mysql, relay = stack.container("mysql"), stack.container("relay")
    try:
        await asyncio.to_thread(mysql.stop, timeout=20)
        async with program.connect("sim1") as socket:
            await open_echo(socket)
            assert await echo(socket, "driving") == "driving"
        await asyncio.to_thread(run_inside, relay, "bash", "-c", "kill -9 -1")
        await asyncio.to_thread(
            stack.wait, "the relay restarted",
            lambda: stack.container("relay").attrs["RestartCount"] > relay.attrs["RestartCount"], "relay",
        )  # fmt: skip
    finally:
        await asyncio.to_thread(mysql.start)
        await asyncio.to_thread(stack.wait_healthy, "mysql")
    drive = (
        f"SELECT 1 FROM drives WHERE robot = 'sim1' AND fence = {fence} AND ended_at IS NOT NULL"
    )
    await asyncio.to_thread(
        stack.wait, "the drive's record", lambda: bool(stack.sql(drive)), "relay"
    )
    await _wait_drivable(program, "sim1")
