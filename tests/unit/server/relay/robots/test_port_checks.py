"""What stands behind a robot's ports, asked over real sockets, and how often it is asked."""

import asyncio
import socket
from contextlib import ExitStack

import pytest
import pytest_asyncio
from fake_robot import HOST
from local_network import free_port
from robotether_server.db.fleet import RelayRobot
from robotether_server.relay.robots.port_checks import (
    PortChecker,
    wait_released,
)


def http(status):
    return b"HTTP/1.1 %d Any Reason\r\n\r\n" % status


HTTP = http(400)
SSH = b"SSH-2.0-OpenSSH_9.2\r\n"


@pytest_asyncio.fixture
async def serve():
    servers = []

    async def start(answer, after_s=0.0):
        async def handle(_reader, writer):
            await asyncio.sleep(after_s)
            writer.write(answer)
            writer.close()

        servers.append(await asyncio.start_server(handle, HOST, 0))
        return int(servers[-1].sockets[0].getsockname()[1])

    yield start
    for server in servers:
        server.close()
        await server.wait_closed()


def robot(ros, video, shell=None):
    return RelayRobot(7, "sim1", "active", ros, video, shell_port=shell)


@pytest.mark.parametrize(
    ("answers", "found"),
    [
        ((HTTP, HTTP, SSH), ("ok", "ok", "ok")),
        # The guard without its rosbridge; of video any status is an answer.
        ((http(502), http(502), SSH), ("down", "ok", "ok")),
        ((http(426), HTTP, SSH), ("ok", "ok", "ok")),
        # A tunnel to nothing closes without a word.
        ((SSH, b"", HTTP), ("down", "down", "down")),
        # Nobody watches, so that nothing is asked.
        ((HTTP, None, SSH), ("ok", "unknown", "ok")),
    ],
)
async def test_each_service_is_known_by_its_first_bytes(serve, answers, found):
    noted = []
    checker = PortChecker(HOST, lambda service, health: noted.append((service, health)))
    ports = [await serve(HTTP if answer is None else answer, 0) for answer in answers]
    health = await checker.check(robot(*ports), video=answers[1] is not None)
    assert health == dict(zip(("ros", "video", "shell"), found, strict=True)) == dict(noted)
    assert len(noted) == len(found)


async def test_no_forward_is_unknown():
    """A port that nobody listens on says nothing about the robot's service."""
    checker = PortChecker(HOST, lambda _service, _health: None)
    found = await checker.check(robot(free_port(), free_port()), video=True)
    assert found == dict.fromkeys(("ros", "video", "shell"), "unknown")


async def test_a_check_takes_a_bounded_time(serve):
    checker = PortChecker(HOST, lambda _service, _health: None, answer_within_s=0.2)
    slow = await serve(HTTP, 0.6)
    health = await checker.check(robot(slow, slow, slow), video=True)
    assert set(health.values()) == {"down"}


async def test_a_host_that_is_away_holds_no_port():
    assert await wait_released("no-such-host.invalid", 20000, within_s=10)


async def test_a_port_whose_holder_is_slow_is_not_released():
    """A connection that is not refused may still be accepted, however long that takes."""
    with socket.create_server((HOST, 0), backlog=0) as holder, ExitStack() as waiting:
        # The kernel drops what comes when so many wait to be accepted.
        for _ in range(4):
            item = waiting.enter_context(socket.socket())
            item.setblocking(False)
            item.connect_ex(holder.getsockname())
        assert not await wait_released(HOST, holder.getsockname()[1], within_s=0.5)
