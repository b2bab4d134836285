"""The way to the server: whichever port answers, what silence costs, and connections in hand."""

import asyncio
import socket
import time
from contextlib import nullcontext
from random import Random

import pytest
from fake_cloud import eventually
from fake_proxy import FakeProxy
from local_network import free_port
from robotether_agent.fields import ListedCell
from robotether_agent.net import server_dialer
from robotether_agent.net.http_proxy import proxy_of
from robotether_agent.net.server_dialer import ServerDialer, SshAddress
from robotether_agent.net.tcp import Resolver
from robotether_agent.problems import NoAnswerError, ServerBusyError, ServerUnreachableError
from ssh_ports import BANNER, SshPort

WAIT_S = 20.0


def at(port, host="127.0.0.1"):
    return SshAddress(host, port, "tunnel")


def cells(*ports):
    return [SshAddress("127.0.0.1", port, "tunnel", cell=ListedCell("", (port,))) for port in ports]


@pytest.fixture
def silent_port():
    """A port whose queue is full, so that the kernel drops what comes, as a packet filter does."""
    with socket.socket() as full:
        full.bind(("127.0.0.1", 0))
        full.listen(0)
        with socket.create_connection(full.getsockname()), socket.socket() as second:
            second.setblocking(False)
            second.connect_ex(full.getsockname())
            yield full.getsockname()[1]


async def words(connection):
    with connection:
        return await asyncio.wait_for(asyncio.get_running_loop().sock_recv(connection, 64), 5)


@pytest.fixture(autouse=True)
def quiet_network(monkeypatch):
    network = server_dialer.netlink.Network()
    monkeypatch.setattr(server_dialer.netlink, "listening", lambda: nullcontext(network))
    return network


async def test_what_was_found_is_what_is_opened():
    """One connection is made, and its first word is still there for ssh; another attempt does not use it up."""
    async with SshPort() as ssh_port:
        dialer = ServerDialer()
        target = await dialer.find([at(ssh_port.port)])
        await dialer.find([at(free_port()), at(ssh_port.port)])
        assert await words(await dialer.open(target)) == BANNER
        assert ssh_port.connections == 1


async def test_a_port_that_drops_everything_costs_little(silent_port):
    """The next port is tried after half a second, and not after a time-out."""
    async with SshPort("shy") as ssh_port:
        dialer = ServerDialer()
        dialer._banner._silent_ports.add(ssh_port.port)
        async with asyncio.timeout(server_dialer.NEXT_PORT_AFTER_S + 2):
            assert await dialer.find([at(silent_port), at(ssh_port.port)]) == at(ssh_port.port)


async def test_a_shy_port_is_remembered_and_gets_a_fresh_connection(monkeypatch):
    """The one on which the agent spoke is not given to ssh; the next time nobody waits for it to begin."""
    monkeypatch.setattr(server_dialer, "SPEAK_AFTER_S", 0.1)
    async with SshPort("shy") as ssh_port:
        dialer = ServerDialer()
        target = await dialer.find([at(ssh_port.port)])
        heard = ssh_port.heard
        (await dialer.open(target)).close()
        assert heard.startswith(b"SSH-2.0-robotether")
        assert ssh_port.port in dialer._banner._silent_ports


async def test_the_sites_port_is_spoken_to_at_once(monkeypatch):
    """Nginx is there, and waits for the client's first words."""
    monkeypatch.setattr(server_dialer, "SPEAK_AFTER_S", WAIT_S * 2)
    async with SshPort("shy") as ssh_port:
        dialer = ServerDialer(https_port=ssh_port.port)
        found = await asyncio.wait_for(dialer.find([at(ssh_port.port)]), WAIT_S)
        assert found == at(ssh_port.port)


@pytest.mark.parametrize(
    ("mode", "kind", "sentence"),
    [
        ("babbles", ServerUnreachableError, "not an SSH server .*302 Log in"),
        ("closes", ServerUnreachableError, "closes the connection silently"),
        ("full", ServerBusyError, "as many log-ins as it accepts"),
        ("full_before_10", ServerBusyError, "as many log-ins as it accepts"),
    ],
)
async def test_what_is_no_ssh_server_or_takes_nobody(mode, kind, sentence):
    async with SshPort(mode) as ssh_port:
        with pytest.raises(kind, match=sentence):
            await asyncio.wait_for(ServerDialer().find([at(ssh_port.port)]), 5)


@pytest.mark.parametrize("tries_by_itself", [True, False])
async def test_it_is_found_soon_after_it_answers(tries_by_itself, quiet_network, monkeypatch):
    if not tries_by_itself:
        monkeypatch.setattr(server_dialer, "TRY_EVERY_S", (60.0, 60.0))
    known = asyncio.Event()

    def lookup(_, port):
        if not known.is_set():
            raise socket.gaierror(-3, "Temporary failure in name resolution")
        return [(socket.AF_INET, ("127.0.0.1", port))]

    async with SshPort() as ssh_port:
        finding = asyncio.ensure_future(
            ServerDialer(rng=Random(1), resolver=Resolver(lookup)).find([at(ssh_port.port, "h")])
        )
        await asyncio.wait({finding}, timeout=0.7)
        known.set()
        if not tries_by_itself:
            quiet_network._event.set()
        assert await asyncio.wait_for(finding, 4) == at(ssh_port.port, "h")


async def test_a_busy_server_is_not_asked_twice_a_second(monkeypatch):
    monkeypatch.setattr(server_dialer, "FIND_TIMEOUT_S", 2.0)
    monkeypatch.setattr(server_dialer, "BUSY_NEXT_PORT_AFTER_S", 3.0)
    monkeypatch.setattr(server_dialer, "BUSY_TRY_AFTER_S", (3.0, 3.0))
    monkeypatch.setattr(server_dialer, "BUSY_FIND_TIMEOUT_S", 4.0)
    async with SshPort("silent") as busy, SshPort("silent") as other:
        finding = asyncio.ensure_future(
            ServerDialer(rng=Random(1)).find([at(busy.port), at(other.port)])
        )
        await asyncio.wait({finding}, timeout=1.5)
        assert (busy.connections, other.connections) == (1, 0)
        with pytest.raises(NoAnswerError):
            await finding
        # One more each, to a server that may have lost the first.
        assert busy.connections + other.connections <= 3


async def test_a_cell_that_drops_everything_costs_two_seconds(silent_port, monkeypatch):
    """Its own ports are not enough of a reason; the second cell refuses, and the third has its turn at once."""
    monkeypatch.setattr(server_dialer, "NEXT_PORT_AFTER_S", 0.1)
    monkeypatch.setattr(server_dialer, "NEXT_CELL_AFTER_S", 0.7)
    async with SshPort() as ssh_port:
        gone = ListedCell("gone", (silent_port, silent_port))
        both = [SshAddress("127.0.0.1", silent_port, "tunnel", cell=gone) for _ in gone.ports]
        began_s = time.monotonic()
        found = await ServerDialer().find([*both, *cells(free_port(), ssh_port.port)])
        assert found == at(ssh_port.port)
        assert 0.7 <= time.monotonic() - began_s < 2.7


async def test_the_time_in_which_a_cell_was_silent_already_counts(silent_port):
    async with SshPort() as ssh_port:
        async with asyncio.timeout(server_dialer.NEXT_CELL_AFTER_S):
            found = await ServerDialer().find(cells(silent_port, ssh_port.port), unreached_s=1.5)
        assert found == at(ssh_port.port)


@pytest.mark.parametrize("mode", ["full", "closes"])
async def test_a_cell_that_takes_nobody_is_left_alone_while_the_next_is_waited_for(
    mode, silent_port, monkeypatch
):
    monkeypatch.setattr(server_dialer, "FIND_TIMEOUT_S", 2.5)
    monkeypatch.setattr(server_dialer, "NEXT_CELL_AFTER_S", 0.3)
    async with SshPort(mode) as busy:
        with pytest.raises(ServerUnreachableError):
            await asyncio.wait_for(ServerDialer().find(cells(busy.port, silent_port)), WAIT_S)
        assert busy.connections == 1


async def test_a_silent_cell_is_left_for_the_next_but_not_at_once(monkeypatch):
    """It may be overloaded: a whole fleet that goes on to the next together would make that one silent, too."""
    monkeypatch.setattr(server_dialer, "NEXT_CELL_AFTER_S", 0.3)
    monkeypatch.setattr(server_dialer, "BUSY_NEXT_CELL_AFTER_S", (0.8, 0.8))
    async with SshPort("silent") as busy, SshPort() as ssh_port:
        began_s = time.monotonic()
        assert await ServerDialer().find(cells(busy.port, ssh_port.port)) == at(ssh_port.port)
        assert 0.7 <= time.monotonic() - began_s < 5
        assert busy.connections == 1


async def test_a_busy_server_is_waited_for(monkeypatch):
    monkeypatch.setattr(server_dialer, "FIND_TIMEOUT_S", 0.0)
    monkeypatch.setattr(server_dialer, "TRY_EVERY_S", (60.0, 60.0))
    async with SshPort("late") as ssh_port, asyncio.timeout(WAIT_S):
        dialer = ServerDialer()
        with dialer._counted_silent():
            finding = asyncio.ensure_future(dialer.find([at(ssh_port.port)]))
            # The test's own, and the one that the door has taken.
            await eventually(lambda: dialer._silent_connections > 1, lambda: "it is taken")
        ssh_port.may_speak.set()
        assert await words(await dialer.open(await finding)) == BANNER
        assert ssh_port.connections == 1


async def test_a_proxy_that_lets_only_443_out():
    async with SshPort("shy") as ssh_port, FakeProxy("only_443", behind_443=ssh_port.port) as proxy:
        dialer = ServerDialer(proxy_of(proxy.url))
        assert dialer.is_proxied
        assert await dialer.find([at(2222), at(443)]) == at(443)
        assert proxy.asked == ["127.0.0.1:2222", "127.0.0.1:443"]
