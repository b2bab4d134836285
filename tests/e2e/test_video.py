"""Cameras through the running stack: one stream leaves the robot, each viewer sees the newest frame."""

from __future__ import annotations

import asyncio
import re
import socket
import ssl
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from itertools import pairwise
from pathlib import Path
from urllib.parse import quote

import aiohttp
import pytest
from frames_viewer import FramesViewer
from local_network import insecure_tls
from playwright.sync_api import BrowserContext
from programs import Program
from stack import Stack, wait_until_back

TOPIC = "/camera/image_raw"
# Steady, so that bytes can be compared.
STEADY = {"quality_min": 60, "quality_max": 60, "fps": 10, "latency_ms": 5000}
# As many as the camera gives: the robot leaves none out by itself.
ALL = {**STEADY, "fps": 30}

NUMBER = re.compile(rb"X-Number: (\d+)\r\n")

Watch = Callable[..., Awaitable[FramesViewer]]


@pytest.fixture(scope="module")
def program(stack: Stack) -> Program:
    """A program with an API token of the admin's; the cameras are there, which a test before may have taken away."""
    wait_until_back(stack, "sim1", "sim2")
    return Program(stack, stack.token("video"))


@asynccontextmanager
async def viewing(program: Program) -> AsyncIterator[Watch]:
    """Open viewers inside the block, with the program's token."""
    async with AsyncExitStack() as opened:
        connector = aiohttp.TCPConnector(ssl=insecure_tls(), limit=0)
        http = await opened.enter_async_context(aiohttp.ClientSession(connector=connector))

        async def watch(robot: str = "sim1", **wanted: object) -> FramesViewer:
            url = f"{program.stack.url}/robots/{robot}/video/frames?topic={quote(TOPIC)}"
            viewer = FramesViewer(
                await http.ws_connect(url, headers=program.headers, max_msg_size=0)
            )
            opened.push_async_callback(viewer.socket.close)
            await viewer.want(**wanted)
            return viewer

        yield watch


async def take(viewer: FramesViewer, seconds: float) -> list[int]:
    """Take pictures for so long as they come, each when the last has come; return their numbers."""
    numbers, end = [], time.monotonic() + seconds
    await viewer.credit(2)
    while time.monotonic() < end:
        numbers.append((await viewer.frame()).sequence)
        await viewer.credit()
    return numbers


def part_of_all(numbers: list[int]) -> float:
    """How many of the pictures that the camera gave meanwhile these are."""
    return len(numbers) / (numbers[-1] - numbers[0] + 1)


def sent_bytes(pid: int) -> int:
    """What the machine of a process has sent over its network so far."""
    lines = Path(f"/proc/{pid}/net/dev").read_text().splitlines()
    [counts] = [line for line in lines if line.strip().startswith("eth0:")]
    return int(counts.partition(":")[2].split()[8])


async def test_one_stream_leaves_the_robot_whoever_watches(stack: Stack, program: Program) -> None:
    """With 1 and with 20 viewers a picture costs the robot's uplink the same, and each viewer gets them all."""
    bytes_a_picture = {}
    # Read here and at once: a command in there takes the time of some pictures, now more and now less.
    sim = stack.container("sim1").attrs["State"]["Pid"]
    for count in (1, 20):
        async with viewing(program) as watch:
            viewers = [await watch(**STEADY) for _ in range(count)]
            # Until it runs evenly.
            begun = await asyncio.gather(*(take(viewer, 1) for viewer in viewers))
            before = sent_bytes(sim)
            taken = await asyncio.gather(*(take(viewer, 5) for viewer in viewers))
            after = sent_bytes(sim)
        assert min(map(len, taken)) > 0.6 * max(map(len, taken))
        # Not those that had been sent before, and that only some had seen by then.
        sent = set().union(*taken).difference(*begun)
        bytes_a_picture[count] = (after - before) / len(sent)
    # The agent's and Docker's own traffic counts as well, and other pictures are larger.
    assert max(bytes_a_picture.values()) < 1.05 * min(bytes_a_picture.values()), bytes_a_picture


async def test_a_slow_viewer_slows_no_one_and_sees_the_newest(program: Program) -> None:
    """Who takes nothing for three seconds finds no queue when it looks again, and the other missed nothing."""
    async with viewing(program) as watch:
        fast, slow = await watch(**ALL), await watch(**ALL)
        alone = await take(fast, 3)
        await slow.credit(2)
        beside = await take(fast, 3)
        # Of what there was: a busy machine makes fewer pictures now, and more then.
        assert part_of_all(beside) > 0.7 * part_of_all(alone)
        # What was under way when it stopped to look.
        old = [await slow.frame() for _ in range(2)]
        fast_taking = asyncio.create_task(take(fast, 1))
        await slow.credit()
        new = await slow.frame()
        # How old it is when it comes, and not when the other has taken all of its own.
        await slow.socket.send_json({"op": "beat", "t_ms": 0})
        now_ms = (await slow.text("beat"))["sender_ms"]
        await fast_taking
        assert new.sequence - old[-1].sequence > len(beside) / 2
        assert new.sequence >= beside[-1]
        assert now_ms - new.timestamp_ms < 1500


@pytest.mark.release
async def test_a_slow_stream_skips_pictures_too(stack: Stack, program: Program) -> None:
    """What an <img> does not take meanwhile is left out at the relay, beside a viewer that takes all."""
    ticket = await asyncio.to_thread(program.ticket, "sim1", "observe")
    path = f"/robots/sim1/video/stream?topic={quote(TOPIC)}&quality=90&ticket={ticket}"
    async with viewing(program) as watch:
        fast = await watch(quality_min=90, quality_max=90, fps=15, latency_ms=5000)
        stream = await asyncio.to_thread(Stream, stack, path)
        with stream.secured:
            begun = await asyncio.to_thread(stream.next_number)
            assert begun is not None
            size, newest = 0, begun
            # At least twice what the way holds. On a busy machine the robot makes its pictures smaller.
            while size < 2_000_000:
                await fast.credit()
                frame = await fast.frame()
                size, newest = size + len(frame.jpeg), frame.sequence
            seen: list[int | None] = [begun]
            # First what was on the way when it stopped to look.
            while seen[-1] is not None and seen[-1] <= newest:
                seen.append(await asyncio.to_thread(stream.next_number))
    # Or it was slow for so long that it was cut: nothing waits for it either.
    gaps = [after - before for before, after in pairwise(seen) if before and after]
    assert seen[-1] is None or max(gaps) > 10, seen


class Stream:
    """A multipart stream of which nothing is read that nobody asked for."""

    def __init__(self, stack: Stack, path: str) -> None:
        # Not through the engine's proxy on this machine, which has buffers of its own.
        networks = stack.container("nginx").attrs["NetworkSettings"]["Networks"]
        plain = socket.socket()
        plain.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 16 * 1024)
        plain.settimeout(10)
        plain.connect((next(iter(networks.values()))["IPAddress"], 8443))
        self.secured = insecure_tls().wrap_socket(plain)
        host = f"localhost:{stack.https_port}"
        self.secured.sendall(f"GET {path} HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
        self._data = b""

    def next_number(self) -> int | None:
        """Read on to the head of the next picture; return its number, None when the stream was cut."""
        while (head := NUMBER.search(self._data)) is None:
            try:
                chunk = self.secured.recv(4096)
            except (ConnectionError, ssl.SSLError):
                return None
            if not chunk:
                return None
            self._data = self._data[-200:] + chunk
        self._data = self._data[head.end() :]
        return int(head[1])


async def test_a_robot_that_restarts_is_watched_again(stack: Stack, program: Program) -> None:
    """Its viewers hear that the link is lost, and a new connection has pictures when it is back."""
    async with viewing(program) as watch:
        viewer = await watch("sim2", **STEADY)
        await take(viewer, 1)
        restart = asyncio.create_task(asyncio.to_thread(stack.container("sim2").restart, timeout=5))
        async with asyncio.timeout(20):
            while (message := await viewer.socket.receive()).type is not aiohttp.WSMsgType.CLOSE:
                assert message.type in {aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY}
        assert message.data == 4505
        await restart
        await asyncio.to_thread(
            stack.wait, "sim2 back", lambda: stack.online("sim2"), "sim2", seconds=60
        )
        deadline = time.monotonic() + 20
        while True:
            again = await watch("sim2", **STEADY)
            await again.credit(2)
            message = await again.socket.receive(timeout=10)
            if message.type is not aiohttp.WSMsgType.CLOSE:
                break
            # The media connection comes a moment after the session.
            assert message.data in {4503, 4505, 4506}
            assert time.monotonic() < deadline, message
        await take(again, 1)


async def test_frames_refuse_who_has_nothing_to_show(stack: Stack) -> None:
    """No ticket, no login, no token: 401 through nginx, and an upgrade on other paths is none."""
    url = f"{stack.url}/robots/sim1/video/frames?topic={quote(TOPIC)}"
    async with aiohttp.ClientSession() as http:
        with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
            await http.ws_connect(url, ssl=insecure_tls())
    assert refused.value.status == 401


def test_a_page_of_another_site_shows_a_stream(
    stack: Stack, context: BrowserContext, program: Program
) -> None:
    """An <img> with a ticket shows moving pictures on a page that has no login here; without one it shows nothing."""
    ticket = program.ticket("sim1", "observe")
    source = f"{stack.url}/robots/sim1/video/stream?topic={quote(TOPIC)}"
    html = f'<img id="good" src="{source}&ticket={ticket}"><img id="bad" src="{source}">'
    # The tests' stack stands on this machine, and Chromium asks before a page from elsewhere looks there.
    context.grant_permissions(["local-network-access"])
    context.route(
        "https://lab.example/**",
        lambda route: route.fulfill(body=f"<!doctype html>{html}", content_type="text/html"),
    )
    page = context.new_page()
    page.goto("https://lab.example/", wait_until="commit")
    page.wait_for_function("document.getElementById('good').naturalWidth > 0", timeout=15_000)
    assert page.evaluate("document.getElementById('bad').naturalWidth") == 0
    good = page.locator("#good")
    first = good.screenshot()
    deadline = time.monotonic() + 10
    while good.screenshot() == first:
        assert time.monotonic() < deadline, "the picture stands still"
    page.close()
