"""A programmer's view: roslibpy and plain WebSockets with an API token, through wss."""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import aiohttp
import pytest
from local_network import insecure_tls
from programs import Program, drive_on, echo, open_echo
from sim_watch import SimWatch
from stack import ROOT, Stack, wait_until_back
from stopwatch import Stopwatch

JPEG_START, JPEG_END = b"\xff\xd8", b"\xff\xd9"


@pytest.fixture(scope="module")
def token(stack: Stack) -> str:
    """An API token of the admin, who finds nobody else at the robots that these tests drive."""
    for robot in ("sim1", "sim2"):
        stack.wait_until_free(robot)
    return stack.token("programs")


@pytest.fixture(scope="module")
def program(stack: Stack, token: str) -> Program:
    """A program with that token."""
    return Program(stack, token)


def run_tutorial(
    stack: Stack, token: str, folder: Path, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run the documented roslibpy program as it stands in docs/, in a folder for its frame."""
    return subprocess.run(
        [sys.executable, str(ROOT / "docs" / "tutorial" / "roslibpy_client.py"), stack.url, "sim1", token],
        env={**os.environ, **environment}, cwd=folder,
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip


@pytest.fixture(scope="module")
def drivers_token(stack: Stack) -> Iterator[str]:
    """A token of a user with level drive on sim1, as README makes one."""
    stack.admin.add_user("programmer")
    stack.admin.grant("programmer", "sim1", "drive")
    stack.wait_for_right("programmer", "sim1")
    yield stack.token("tutorial", "programmer")
    stack.admin.remove("users", "programmer")


def test_tutorial_drives_with_level_drive_and_saves_a_frame(
    stack: Stack, drivers_token: str, tmp_path: Path
) -> None:
    """The program says how far the robot came, and logs no error on the way."""
    with SimWatch(stack, "sim1") as watch:
        done = run_tutorial(stack, drivers_token, tmp_path, ROBOTETHER_INSECURE="1")
        sent = [seen.msg["linear"]["x"] for seen in watch.commands()]
    assert done.returncode == 0, done.stderr
    moved = re.search(r"sim1 moved (\S+) m", done.stdout)
    assert moved is not None, done.stdout
    # A metre is more than any delay of the last command adds to the 0.2 m.
    assert 0 < float(moved[1]) < 1
    assert "Traceback" not in done.stderr
    assert "error:" not in done.stderr
    assert 0.2 in sent
    assert sent[-1] == 0
    picture = (tmp_path / "sim1.jpg").read_bytes()
    assert picture.startswith(JPEG_START)
    assert picture.endswith(JPEG_END)


def test_tutorial_prints_why_it_is_refused(
    stack: Stack, drivers_token: str, tmp_path: Path
) -> None:
    """A certificate that nobody signed and a robot that is stopped end the program with one sentence."""
    untrusted = run_tutorial(stack, drivers_token, tmp_path)
    assert untrusted.returncode == 1
    assert "ROBOTETHER_INSECURE=1" in untrusted.stderr
    stack.admin.ask("POST", "/robots/sim1/stop", {"reason": "tutorial"})
    try:
        stopped = run_tutorial(stack, drivers_token, tmp_path, ROBOTETHER_INSECURE="1")
    finally:
        stack.admin.ask("POST", "/robots/sim1/release")
    assert stopped.returncode == 1
    assert "stopped" in stopped.stderr
    assert "Traceback" not in untrusted.stderr + stopped.stderr


async def test_broken_json_leaves_the_connection_alive(program: Program) -> None:
    """Rubbish gets a status error and the next message works."""
    async with program.connect("sim1") as socket:
        await socket.send_str('{"op": "publish", "topic": ')
        answer = await asyncio.wait_for(socket.receive_json(), 5)
        assert (answer["op"], answer["level"]) == ("status", "error")
        await open_echo(socket)
        assert await echo(socket, "still here") == "still here"


async def test_too_large_message_ends_that_connection_only(program: Program) -> None:
    """11 MB ends the connection that sent it with 1009, and its neighbour does not notice."""
    big = '{"op":"publish","topic":"/x","msg":{"data":"' + "x" * 11_000_000 + '"}}'

    async def send(socket: aiohttp.ClientWebSocketResponse) -> aiohttp.WSMessage:
        with contextlib.suppress(ConnectionError, aiohttp.ClientError):  # it may end in mid-message
            await socket.send_str(big)
        return await asyncio.wait_for(socket.receive(), 10)

    async with program.connect("sim2") as other:
        await open_echo(other)
        # Sends at once: a driver of whom nothing comes, no pong either, is gone after 2.5 s.
        async with program.connect("sim1") as socket:
            frame = await drive_on(other, send(socket))
        assert frame.type in (
            aiohttp.WSMsgType.CLOSE,
            aiohttp.WSMsgType.CLOSED,
            aiohttp.WSMsgType.ERROR,
        )
        assert socket.close_code in (1009, 1006)
        assert await echo(other, "unmoved") == "unmoved"


@pytest.mark.parametrize(
    ("query", "code"),
    [
        ("", "ticket_missing"),
        ("?ticket=rubbish", "ticket_malformed"),
        ("?ticket=eyJpZCI6ICIxIn0.aaaaaa.bbbbbbbbbbbbbbbbbbbbbbbbbbb", "ticket_forged"),
    ],
)
def test_bad_ticket_is_401_with_a_code(stack: Stack, query: str, code: str) -> None:
    """No, broken and forged tickets are told apart."""
    upgrade = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13",
               "Sec-WebSocket-Key": "MDEyMzQ1Njc4OWFiY2RlZg=="}  # fmt: skip
    status, answer = stack.request("GET", f"/robots/sim1/ros{query}", headers=upgrade)
    assert (status, answer["code"]) == (401, code)


async def test_ticket_opens_one_connection(program: Program) -> None:
    """The second use of a ticket is refused with its code."""
    ticket = await asyncio.to_thread(program.ticket, "sim1")
    async with program.connect("sim1", ticket=ticket):
        with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
            async with program.connect("sim1", ticket=ticket):
                pass
        assert refused.value.status == 401


async def test_ticket_of_another_robot_is_refused(program: Program) -> None:
    """A ticket for sim2 does not open sim1."""
    ticket = await asyncio.to_thread(program.ticket, "sim2")
    with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
        async with program.connect("sim1", ticket=ticket):
            pass
    assert refused.value.status == 401


async def test_page_of_another_origin_is_refused(program: Program) -> None:
    """A browser that runs another site's page gets no connection even with a good ticket."""
    with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
        async with program.connect("sim1", origin="https://evil.example"):
            pass
    assert refused.value.status == 403


def test_unknown_robot_is_404(stack: Stack, program: Program) -> None:
    """A ticket for a robot that does not exist is refused by name."""
    status, answer = stack.request(
        "POST", "/api/v1/tickets", {"robot": "nobody", "mode": "drive"}, program.headers
    )
    assert (status, answer["code"]) == (404, "robot_unknown")


async def test_offline_robot_closes_with_a_reason(program: Program, stack: Stack) -> None:
    """A robot that is switched off ends the WebSocket within a second, saying since when."""
    sim = stack.container("sim3")
    await asyncio.to_thread(sim.stop, timeout=5)
    try:
        await asyncio.to_thread(
            stack.wait, "sim3 offline", lambda: not stack.online("sim3"), "relay"
        )
        with Stopwatch() as since:
            async with program.connect("sim3") as socket:
                frame = await asyncio.wait_for(socket.receive(), 5)
                told_after_s = since.s
        assert frame.type is aiohttp.WSMsgType.CLOSE
        assert told_after_s < 1.5
        assert frame.data == 4503
        assert "sim3 has been offline since" in frame.extra
    finally:
        await asyncio.to_thread(sim.start)
        await asyncio.to_thread(wait_until_back, stack, "sim3")


def test_video_needs_a_login_or_ticket(stack: Stack, program: Program) -> None:
    """web_video_server's URLs answer 401 without one and a picture with one."""
    path = "/robots/sim1/video/snapshot?topic=/camera/image_raw"
    status, answer = stack.request("GET", path)
    assert (status, answer["code"]) == (401, "login_missing")
    ticket = program.ticket("sim1", "observe")
    status, picture = stack.request("GET", f"{path}&ticket={ticket}")
    assert status == 200
    assert "JFIF" in picture[:32]


async def test_video_streams_frames(program: Program, stack: Stack) -> None:
    """The stream is MJPEG as web_video_server sends it, frame after frame."""
    url = f"{stack.url}/robots/sim1/video/stream?topic=/camera/image_raw&type=mjpeg&quality=60&width=320&height=240"
    async with (
        aiohttp.ClientSession(headers=program.headers) as http,
        http.get(url, ssl=insecure_tls()) as answer,
    ):
        assert answer.status == 200
        assert answer.content_type == "multipart/x-mixed-replace"
        reader = aiohttp.MultipartReader.from_response(answer)
        for _ in range(5):
            part = await asyncio.wait_for(reader.next(), 5)
            assert isinstance(part, aiohttp.BodyPartReader)
            frame = await part.read()
            assert frame[:2] == b"\xff\xd8"
