"""The whole agent with its guard, against a real sshd and a fake relay."""

from __future__ import annotations

import asyncio
import os
import signal
import time
from contextlib import suppress
from http import HTTPStatus

import aiohttp
import processes
import pytest
from fake_cloud import echo, eventually
from openssh_server import command_line, descendants

# A machine that runs other tests beside this one is slower than a robot.
BACK_WITHIN_S = 2.0
TEN_S = 10.0


async def test_a_killed_guard_is_back_within_a_second(make_cloud, start_agent):
    """The port of the robot leads to the next guard, over the same connection."""
    cloud = await make_cloud()
    agent = start_agent(cloud)
    await agent.until_connected()
    assert await echo(cloud.ports[0], "before") == "before"
    killed_at = time.monotonic()
    os.kill(guard_pid(), signal.SIGKILL)
    while True:
        with suppress(aiohttp.ClientError, TypeError):
            assert await echo(cloud.ports[0], "after") == "after"
            break
        assert time.monotonic() - killed_at < TEN_S
        await asyncio.sleep(0.02)
    assert time.monotonic() - killed_at < BACK_WITHIN_S
    assert len(cloud.of_kind("session", live=False)) == 1
    link = await cloud.link("session")

    def states() -> list[str]:
        return [line["state"] for line in link.of_type("guard")]

    await eventually(lambda: states()[-2:] == ["down", "ready"], lambda: f"{states()}")


async def test_a_stop_outlives_the_agent(make_cloud, start_agent):
    """A robot that somebody stopped is still stopped after its next boot, and says so to the server."""
    cloud = await make_cloud()
    agent = start_agent(cloud)
    await agent.until_connected()
    link = await cloud.link("session")
    link.send({"type": "stop", "id": "5f0c", "by": "ben"})
    await agent.until(lambda status: status.stopped_by == "ben", "stopped")
    await eventually(
        lambda: "5f0c" in [line["answers"] for line in link.of_type("guard")],
        lambda: f"an answer in {link.received}",
    )
    await agent.stop()
    agent = start_agent(cloud)
    link = await cloud.link("session", number=2)
    await eventually(lambda: bool(link.of_type("guard")), lambda: f"{link.received}")
    assert link.of_type("guard")[0]["stopped"]
    await agent.until(lambda status: status.stopped_by == "ben", "still stopped")
    link.send({"type": "release", "id": "77aa", "by": "ann"})
    await agent.until(lambda status: status.stopped_by == "", "released")


async def test_only_the_relay_of_this_session_gets_past_the_guard(make_cloud, start_agent):
    """Whoever else reaches the robot's port has no key, and the bare port leads nowhere else."""
    cloud = await make_cloud()
    await start_agent(cloud).until_connected()
    with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
        await echo(cloud.ports[0], "x", key="another")
    assert refused.value.status == HTTPStatus.FORBIDDEN


async def test_a_server_older_than_the_guard_drives_nobody(make_cloud, start_agent):
    """It gets no key to show, and the status says why nobody can drive."""
    cloud = await make_cloud()
    cloud.guard = None
    agent = start_agent(cloud)
    status = await agent.until(lambda status: bool(status.guard_detail), "the guard says why")
    assert "the server is older than the guard" in status.guard_detail
    await agent.until_connected()
    with pytest.raises(aiohttp.WSServerHandshakeError):
        await echo(cloud.ports[0], "x", key="")


async def test_without_a_guard_the_forward_is_bare(make_cloud, start_agent, caplog):
    """The paper's own way: the port leads straight to rosbridge, and everybody is told."""
    cloud = await make_cloud()
    agent = start_agent(cloud, guard="off")
    status = await agent.until_connected()
    assert await echo(cloud.ports[0], "x", key="") == "x"
    assert status.guard == "off"
    assert (await cloud.link("session")).of_type("hello")[0]["guard"] == "off"
    assert "nothing stops this robot" in caplog.text


def guard_pid() -> int:
    """The guard that this process's agent has started."""
    # Another one may wait on the bench.
    return processes.oldest(
        pid for pid in descendants(os.getpid()) if "robotether_agent.guard" in command_line(pid)
    )
