"""One SSH connection: its children and its control socket never stay behind."""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from fake_cloud import eventually
from openssh_server import command_line, descendants, wait_until
from robotether_agent.enrolment.join import parse_host_keys
from robotether_agent.enrolment.keys import ensure_key, pin_host_keys
from robotether_agent.net.server_dialer import SshAddress
from robotether_agent.problems import SshMissingError
from robotether_agent.tunnel.openssh import Forward, SshFiles
from robotether_agent.tunnel.tunnel import Tunnel

# The differentiated services code point, of which TOS has the upper six bits.
AF21 = 18


@pytest.fixture
async def dialer(make_cloud, place):
    cloud = await make_cloud()
    key = await ensure_key(place)
    cloud.authorize(key.public)
    pin_host_keys(place / "known_hosts", parse_host_keys({"host_keys": cloud.ssh.host_keys}))
    files = SshFiles((key.path,), place / "known_hosts", place / "session.ctl")
    return cloud, SshAddress("127.0.0.1", cloud.ssh.port, cloud.ssh.user), files


@asynccontextmanager
async def opened(target: SshAddress, files: SshFiles) -> AsyncIterator[Tunnel]:
    tunnel = await Tunnel.open(target, files, "session")
    try:
        assert await asyncio.wait_for(tunnel.lines_in.readline(), 10)
        yield tunnel
    finally:
        await tunnel.close()


async def test_a_stale_control_socket_is_removed(dialer):
    cloud, target, files = dialer
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(files.control))
    async with opened(target, files) as tunnel:
        await tunnel.add(Forward(cloud.ports[0], "127.0.0.1", 9))


async def test_a_client_that_an_agent_left_is_ended(dialer):
    _, target, files = dialer
    async with opened(target, files) as left, opened(target, files):
        assert (await left.why_ended(was_connected=True)).code == "link_lost"


@pytest.fixture
async def waiting(place):
    with socket.create_server(("127.0.0.1", 0)) as silent:
        target = SshAddress("127.0.0.1", silent.getsockname()[1], "tunnel")
        files = SshFiles((place / "key",), place / "known_hosts", place / "session.ctl")
        yield await Tunnel.open(target, files, "session")


async def test_close_before_it_connects(waiting):
    await asyncio.wait_for(waiting.close(), 5)
    assert not clients()


async def test_a_close_that_is_cut_short_kills(waiting):
    closing = asyncio.ensure_future(waiting.close())
    await asyncio.sleep(0)
    closing.cancel()
    await asyncio.wait({closing})
    await waiting.close()
    wait_until(lambda: not clients(), lambda: "ssh has ended", 5)


async def test_the_client_runs_on_our_connection(dialer):
    cloud, target, files = dialer
    async with opened(target, files) as tunnel:
        assert tunnel.socket is not None
        assert tunnel.socket.getpeername() == ("127.0.0.1", cloud.ssh.port)
        assert tunnel.socket.getsockopt(socket.IPPROTO_IP, socket.IP_TOS) == AF21 << 2
    assert tunnel.socket.fileno() == -1


async def test_no_descriptor_stays_open(dialer, place, monkeypatch):
    _, target, files = dialer
    before = _descriptors()
    async with opened(target, files):
        pass
    with monkeypatch.context() as without_ssh:
        without_ssh.setenv("PATH", str(place))
        with pytest.raises(SshMissingError, match="openssh-client"):
            await Tunnel.open(target, files, "session")
    await eventually(lambda: _descriptors() <= before, lambda: f"{_descriptors()} of {before}")


def clients() -> list[int]:
    return [pid for pid in descendants(os.getpid()) if "session.ctl" in command_line(pid)]


def _descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))
