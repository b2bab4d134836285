"""Whatever is cut comes back by itself, and what need not notice does not."""

import asyncio
import json
import time
from contextlib import suppress
from http.client import HTTPException
from socket import create_connection

import pytest
from inside import run_inside
from programs import Program, drive_on, echo, open_echo
from stack import wait_until_back

# The robot that gets a new key.
RENEWED = "sim3"
DRIVABLE_WITHIN_S = 40


@pytest.fixture(scope="module")
def program(stack):
    """A program with an API token of the admin; afterwards all robots are back for the tests that follow."""
    yield Program(stack, stack.token("recovery"))
    wait_until_back(stack, "sim1", "sim2", "sim3")


def _wait_restarted(stack, service, before, seconds=30):
    count = before.attrs["RestartCount"]
    stack.wait(
        f"{service} restarted",
        lambda: stack.container(service).attrs["RestartCount"] > count,
        service,
        seconds=seconds,
    )


async def _drivable(program, robot):
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


async def _wait_drivable(program, robot):
    started = time.monotonic()
    while not await _drivable(program, robot):
        if time.monotonic() - started > DRIVABLE_WITHIN_S:
            logs = await asyncio.to_thread(program.stack.logs, robot, "sshd", "relay")
            raise AssertionError(f"{robot} is not drivable\n{logs}")
        await asyncio.sleep(0.2)


async def test_services_that_are_killed_come_back(program, stack):
    killed = {service: stack.container(service) for service in ("relay", "sshd", "nginx", "web")}
    for container in killed.values():
        # A kill by the engine counts as a stop that was wanted; the process must die by itself to be restarted.
        # Not by the engine's SDK, which then asks how the command ended: the engine forgets that with its end.
        await asyncio.to_thread(run_inside, container, "bash", "-c", "kill -9 -1")
    for service, container in killed.items():
        await asyncio.to_thread(_wait_restarted, stack, service, container)
        await asyncio.to_thread(stack.wait_healthy, service)
    for robot in ("sim1", "sim2", "sim3"):
        await _wait_drivable(program, robot)


def _signal_all(container, name):
    run_inside(container, "bash", "-c", f"kill -{name} -1")


async def test_health_says_from_outside_what_hangs(program, stack):
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


async def test_a_new_key_does_not_end_the_drive(program, stack):
    """A robot makes itself a new key on request while it is driven; restarted, it comes in with that key."""

    def fingerprint():
        return str(stack.admin.ask("GET", f"/robots/{RENEWED}")["fingerprint"])

    def shown_by_robot():
        status = stack.exec(RENEWED, "cat", "/run/robotether-agent/status.json")
        return str(json.loads(status)["fingerprint"])

    def wait_renewed():
        stack.wait("a new key", lambda: fingerprint() != before, RENEWED)

    await _wait_drivable(program, RENEWED)
    before = await asyncio.to_thread(fingerprint)
    async with program.connect(RENEWED) as socket:
        await open_echo(socket)
        await asyncio.to_thread(stack.admin.ask, "POST", f"/robots/{RENEWED}/rotate-key")
        await drive_on(socket, asyncio.to_thread(wait_renewed))
        # Longer than the relay needs to see the row change.
        await drive_on(socket, asyncio.sleep(2))
    # The agent writes it down after the server has taken the key.
    await asyncio.to_thread(
        stack.wait, "told by the robot", lambda: shown_by_robot() == fingerprint(), RENEWED
    )
    await asyncio.to_thread(stack.container(RENEWED).restart, timeout=5)
    await _wait_drivable(program, RENEWED)


async def test_log_ins_through_443_come_back(stack):
    """The killed master of sshd's nginx leaves no worker that keeps its port from the next one, or carries robots."""

    def master():
        return stack.exec("sshd", "cat", "/run/robotether/proxy-protocol/nginx.pid").strip()

    killed = await asyncio.to_thread(master)
    await asyncio.to_thread(stack.exec, "sshd", "kill", "-KILL", killed)

    def answers():
        # The old worker answers, too, until it is ended.
        if master() in {"", killed}:
            return False
        with suppress(OSError), create_connection(("localhost", stack.https_port), 5) as ssh:
            ssh.sendall(b"SSH-2.0-test\r\n")
            return ssh.recv(8) == b"SSH-2.0-"
        return False

    await asyncio.to_thread(stack.wait, "SSH at 443", answers, "sshd")
    assert "Address already in use" not in await asyncio.to_thread(stack.logs, "sshd")


@pytest.mark.release
async def test_services_that_hang_come_back(program, stack):
    hung = {service: stack.container(service) for service in ("relay", "web", "nginx", "mysql")}
    for container in hung.values():
        await asyncio.to_thread(_signal_all, container, "STOP")
    for service, container in hung.items():
        await asyncio.to_thread(_wait_restarted, stack, service, container, 120)
        await asyncio.to_thread(stack.wait_healthy, service)
    for robot in ("sim1", "sim2", "sim3"):
        await _wait_drivable(program, robot)


async def test_driving_goes_on_and_begins_without_the_database(program, stack):
    """Who drives, or drove shortly before, does not notice; the records outlive a relay that is killed."""
    mysql, relay = stack.container("mysql"), stack.container("relay")
    await _wait_drivable(program, "sim1")
    newest = "FROM control_leases JOIN robots ON robots.id = robot_id WHERE name = 'sim1'"
    [[fence]] = await asyncio.to_thread(stack.sql, f"SELECT fence {newest}")
    ended = "AND ended_at IS NOT NULL"
    drives = f"SELECT COUNT(*) FROM drives WHERE robot = 'sim1' AND fence > {fence} {ended}"
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
        await asyncio.to_thread(run_inside, relay, "bash", "-c", "kill -9 -1")
        await asyncio.to_thread(_wait_restarted, stack, "relay", relay)
    finally:
        await asyncio.to_thread(mysql.start)
        await asyncio.to_thread(stack.wait_healthy, "mysql")
    await asyncio.to_thread(
        stack.wait, "the drives' records", lambda: stack.sql(drives) == [["2"]], "relay"
    )
    await _wait_drivable(program, "sim1")
