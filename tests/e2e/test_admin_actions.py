"""What an admin does to a robot reaches its live tunnel, and the audit log."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Iterator

import aiohttp
import pytest
from programs import Program, drive_on, echo, open_echo
from stack import Stack, wait_until_back

ROBOT = "sim3"
# Longer than any of these connections may take to end.
HANGS_S = 30.0


@pytest.fixture(scope="module")
def program(stack: Stack) -> Iterator[Program]:
    """A program with an API token of the admin; afterwards the robot is back for the tests that follow."""
    yield Program(stack, stack.token("actions"))
    wait_until_back(stack, ROBOT)


@pytest.fixture(autouse=True)
async def drivable(program: Program) -> None:
    """Each test begins with a robot that can be driven under its own name, some time after it is online."""
    await open_by(program, ROBOT)


def robot(program: Program, name: str = ROBOT) -> dict[str, object]:
    status, body = program.stack.request("GET", f"/api/v1/robots/{name}", headers=program.headers)
    assert status == 200, body
    return dict(body)


def change(program: Program, method: str, path: str, body: dict[str, object] | None = None) -> None:
    status, answer = program.stack.request(method, path, body, program.headers)
    assert status in (200, 204), answer


def audited(stack: Stack, kind: str, name: str = ROBOT) -> str:
    """Who did that to the robot last, by the audit log."""
    found = stack.sql(
        f"SELECT actor FROM audit_events WHERE kind = '{kind}' AND robot = '{name}' ORDER BY id DESC LIMIT 1"
    )
    return found[0][0] if found else "nobody"


async def closed(socket: aiohttp.ClientWebSocketResponse) -> int | None:
    async with asyncio.timeout(HANGS_S):
        async for _ in socket:
            pass
    return socket.close_code


async def until(what: str, condition: Callable[[], bool]) -> None:
    end = time.monotonic() + HANGS_S
    while not await asyncio.to_thread(condition):
        assert time.monotonic() < end, f"still not {what}"
        await asyncio.sleep(0.05)


async def test_renaming_keeps_the_tunnel(program: Program, stack: Stack) -> None:
    """Who drives has to open the robot by its new name, and its tunnel does not notice."""
    path = "/api/v1/robots"
    before = await asyncio.to_thread(sessions, program, ROBOT)
    async with program.connect(ROBOT) as socket:
        await open_echo(socket)
        await asyncio.to_thread(change, program, "PATCH", f"{path}/{ROBOT}", {"name": "turtle"})
        try:
            assert await closed(socket) == 4001
            await open_by(program, "turtle")
            assert await asyncio.to_thread(sessions, program, "turtle") == before
            assert audited(stack, "robot_renamed", "turtle") == "admin"
        finally:
            await asyncio.to_thread(change, program, "PATCH", f"{path}/turtle", {"name": ROBOT})
            await open_by(program, ROBOT)


def sessions(program: Program, name: str) -> list[dict[str, object]]:
    path = f"/api/v1/robots/{name}/sessions"
    status, body = program.stack.request("GET", path, headers=program.headers)
    assert status == 200, body
    return list(body["sessions"])


async def open_by(program: Program, name: str) -> None:
    """Wait until the robot can be driven under that name."""
    end = time.monotonic() + 2 * HANGS_S
    while not await _opens(program, name):
        assert time.monotonic() < end, f"{name} does not open"
        await asyncio.sleep(0.05)


async def _opens(program: Program, name: str) -> bool:
    try:
        async with program.connect(name) as socket:
            await open_echo(socket)
            return await echo(socket, "there") == "there"
    except (aiohttp.ClientError, TimeoutError, TypeError):
        return False


async def test_a_new_key_does_not_end_the_drive(program: Program, stack: Stack) -> None:
    """A robot makes itself a new key on request while it is driven; restarted, it comes in with that key."""
    before = await asyncio.to_thread(robot, program)
    async with program.connect(ROBOT) as socket:
        await open_echo(socket)
        await asyncio.to_thread(change, program, "POST", f"/api/v1/robots/{ROBOT}/rotate-key")
        renewed = until("a new key", lambda: robot(program)["fingerprint"] != before["fingerprint"])
        await drive_on(socket, renewed)
        # Longer than the relay needs to see the row change.
        await drive_on(socket, asyncio.sleep(2))
    after = await asyncio.to_thread(robot, program)
    # The agent writes it down after the server has taken the key.
    await until("told by the robot", lambda: shown_by_robot(stack) == after["fingerprint"])
    await asyncio.to_thread(stack.container(ROBOT).restart, timeout=5)
    await open_by(program, ROBOT)


def shown_by_robot(stack: Stack) -> str:
    """The fingerprint that the robot shows to whoever stands before it."""
    status = stack.exec(ROBOT, "cat", "/run/robotether-agent/status.json")
    return str(json.loads(status)["fingerprint"])
