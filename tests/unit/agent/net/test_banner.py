"""Whether SSH is behind a connection."""

from __future__ import annotations

import pytest
from robotether_agent.net import server_dialer
from robotether_agent.net.server_dialer import Banner
from robotether_agent.net.tcp import Resolver, connect
from robotether_agent.problems import NoAnswer, ServerBusy, ServerUnreachable
from ssh_ports import SshPort


@pytest.fixture(autouse=True)
def in_haste(monkeypatch):
    """Nobody waits long for the silent."""
    monkeypatch.setattr(server_dialer, "SPEAK_AFTER_S", 0.1)
    monkeypatch.setattr(server_dialer, "BANNER_TIMEOUT_S", 0.3)


async def check(door: SshPort, checker: Banner) -> bool:
    with await connect("127.0.0.1", door.port, Resolver(), "the door") as connection:
        return await checker.check(connection, door.port, "the door")


async def test_a_shy_one_is_spoken_to_and_remembered():
    """The connection is spent; the next time nobody waits for it to begin."""
    async with SshPort("shy") as door:
        checker = Banner()
        assert not await check(door, checker)
        assert door.heard.startswith(b"SSH-2.0-")
        assert door.port in checker._silent_ports
        assert not await check(door, checker)


async def test_the_sites_port_is_spoken_to_at_once(monkeypatch):
    """Nginx is there, and waits for the client's first words."""
    monkeypatch.setattr(server_dialer, "SPEAK_AFTER_S", 60.0)
    async with SshPort("shy") as door:
        assert not await check(door, Banner(https_port=door.port))


async def test_a_silent_one():
    """What accepts and says nothing is as good as no answer."""
    async with SshPort("silent") as door:
        with pytest.raises(NoAnswer, match="the door: it accepts the connection but stays silent"):
            await check(door, Banner())


@pytest.mark.parametrize(
    ("mode", "told"), [("babbles", "no SSH server .*302 Log in"), ("closes", "closes the conn")]
)
async def test_one_that_is_no_ssh_server(mode, told):
    async with SshPort(mode) as door:
        with pytest.raises(ServerUnreachable, match=told):
            await check(door, Banner())


@pytest.mark.parametrize("mode", ["full", "full_before_10"])
async def test_a_server_that_lets_no_more_log_ins_begin(mode):
    async with SshPort(mode) as door:
        with pytest.raises(ServerBusy, match="as many log-ins as it accepts"):
            await check(door, Banner())
