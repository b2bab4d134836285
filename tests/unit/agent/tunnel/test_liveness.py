"""When a silent connection is given up: never while it works, and soon when the server answers elsewhere."""

import asyncio
import socket
from contextlib import nullcontext
from dataclasses import dataclass, field
from types import SimpleNamespace
from unittest.mock import Mock

import pytest
from fake_cloud import eventually
from robotether_agent.clock import robot_time
from robotether_agent.fields import ListedCell
from robotether_agent.net import netlink
from robotether_agent.net.server_dialer import SshAddress
from robotether_agent.problems import NetworkChangedError, NoAnswerError, Retry, ServerSilentError
from robotether_agent.tunnel import liveness
from robotether_agent.tunnel.liveness import Path, Signs, is_certain, path_of, suspicion, watch


def ends(here, there, family=socket.AF_INET):
    """A connection with these two ends."""
    return Mock(family=family, getsockname=lambda: here, getpeername=lambda: there)


@pytest.mark.parametrize(("host", "path"), [("127.0.0.1", Path.SAME), ("127.0.0.2", Path.MOVED)])
def test_a_real_connection(host, path):
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        socket.create_connection(server.getsockname(), source_address=(host, 0)) as connection,
    ):
        assert path_of(connection) is path


def test_its_address_is_gone():
    assert path_of(ends(("192.0.2.1", 1), ("127.0.0.1", 2))) is Path.GONE


@pytest.mark.parametrize(
    ("now", "path"), [("2001:db8::b", Path.SAME), ("2001:db8:0:1::b", Path.MOVED)]
)
def test_an_address_that_ipv6_renews(monkeypatch, now, path):
    """The old one goes on working for days, and somebody may drive."""
    monkeypatch.setattr(liveness, "_is_ours", lambda *_: True)
    monkeypatch.setattr(liveness, "_source_towards", lambda *_: now)
    both = ("2001:db8::a", 1, 0, 0), ("2001:db8:9::1", 2222, 0, 0)
    assert path_of(ends(*both, socket.AF_INET6)) is path


@pytest.mark.parametrize(
    ("signs", "problem", "certain"),
    [
        (Signs(Path.SAME, 9.0, is_stuck=False), None, False),
        (Signs(Path.SAME, 1.1, is_stuck=True), None, False),
        (Signs(Path.SAME, 1.3, is_stuck=True), ServerSilentError, False),
        (Signs(Path.SAME, 0.7, is_stuck=True, is_distrusted=True), ServerSilentError, False),
        (Signs(Path.SAME, 0.7, is_stuck=False, is_distrusted=True), None, False),
        (Signs(Path.SAME, 4.5, is_stuck=True), ServerSilentError, True),
        (Signs(Path.SAME, 2.6, is_stuck=True, idle_delay_s=1.5), None, False),
        (Signs(Path.SAME, 2.8, is_stuck=True, idle_delay_s=1.5), ServerSilentError, False),
        (Signs(Path.MOVED, 0.1, is_stuck=False), NetworkChangedError, False),
        (Signs(Path.MOVED, 4.5, is_stuck=True), ServerSilentError, True),
        (Signs(Path.MOVED, 0.7, is_stuck=False, is_driven=True), None, False),
        (Signs(Path.MOVED, 0.7, is_stuck=True, is_driven=True), ServerSilentError, False),
        (Signs(Path.GONE, 0.1, is_stuck=False), NetworkChangedError, True),
    ],
)
def test_what_the_signs_mean(signs, problem, certain):
    """A server that is slow is not suspected, a dead path is, and only a few signs need no proof."""
    found = suspicion(signs)
    assert type(found) is (problem or type(None))
    assert found is None or found.retry is Retry.AT_ONCE
    assert is_certain(signs) is certain


@dataclass
class FakeDialer:
    """Reaches a server that answers when the test lets it."""

    is_proxied: bool = True
    answers: asyncio.Event = field(default_factory=asyncio.Event)
    asked: int = 0
    ended: int = 0
    fails: bool = False
    targets: list[SshAddress] = field(default_factory=list)
    unreached_s: float = 0.0

    async def find(self, targets, *, unreached_s=0.0):
        self.asked += 1
        self.targets, self.unreached_s = targets, unreached_s
        try:
            if not self.fails:
                await self.answers.wait()
            if self.fails:
                raise NoAnswerError("nobody is there")
            return targets[-1]
        finally:
            self.ended += 1

    async def open(self, target):
        raise AssertionError("a watch opens nothing")


OTHER = SshAddress("127.0.0.1", 9, "tunnel", cell=ListedCell("127.0.0.1", (9,)))


@pytest.fixture(autouse=True)
def check_every_s(request, monkeypatch):
    monkeypatch.setattr(liveness, "CHECK_EVERY_S", getattr(request, "param", 0.02))


@pytest.fixture
def network(monkeypatch):
    network = netlink.Network()
    monkeypatch.setattr(netlink, "listening", lambda: nullcontext(network))
    return network


@pytest.fixture
async def watched(network, spawn):
    """A watch over a connection of this machine's, with a session, a dialer and a network that the test moves."""
    session, dialer = SimpleNamespace(silent_s=0.0, idle_delay_s=0.0), FakeDialer()
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        socket.create_connection(server.getsockname()) as connection,
    ):
        target = SshAddress("127.0.0.1", server.getsockname()[1], "tunnel", dialer)
        tunnel = SimpleNamespace(socket=connection)
        task = spawn(watch(session, tunnel, target, lambda: [OTHER], lambda: False))
        yield session, dialer, task
        task.cancel()


async def test_silence_ends_it_when_the_server_answers_elsewhere(watched):
    session, dialer, task = watched
    session.silent_s = 2.0
    await eventually(lambda: dialer.asked == 1, lambda: f"{dialer}")
    assert not task.done()
    dialer.answers.set()
    with pytest.raises(ServerSilentError, match=r"silent for 2\.0 s"):
        await asyncio.wait_for(task, 5)


async def test_a_silent_cell_may_be_answered_for_by_another(watched):
    session, dialer, _ = watched
    session.silent_s, session.idle_delay_s = 3.2, 1.5
    await eventually(lambda: dialer.asked == 1, lambda: f"{dialer}")
    assert dialer.targets[1:] == [OTHER]
    assert abs(dialer.unreached_s - 1.7) < 1e-6


async def test_a_session_that_speaks_again_is_kept(watched):
    session, dialer, task = watched
    session.silent_s = 2.0
    await eventually(lambda: dialer.asked == 1, lambda: f"{dialer}")
    session.silent_s = 0.1
    await eventually(lambda: dialer.ended == 1, lambda: f"{dialer}")
    dialer.answers.set()
    await asyncio.wait({task}, timeout=0.1)
    assert not task.done()


@pytest.mark.parametrize("idle_delay_s", [0.0, 1.5])
async def test_a_new_network_that_leads_nowhere_is_not_asked_all_the_time(
    watched, monkeypatch, idle_delay_s
):
    session, dialer, task = watched
    session.silent_s = session.idle_delay_s = idle_delay_s
    dialer.fails = True
    monkeypatch.setattr(liveness, "path_of", lambda _: Path.MOVED)
    await eventually(lambda: dialer.asked == 1, lambda: f"{dialer}")
    await asyncio.wait({task}, timeout=0.2)
    assert dialer.asked == 1
    assert not task.done()


async def test_a_new_network_takes_over_when_the_server_answers_there(watched, monkeypatch):
    _, dialer, task = watched
    monkeypatch.setattr(liveness, "path_of", lambda _: Path.MOVED)
    dialer.answers.set()
    with pytest.raises(NetworkChangedError, match="another network"):
        await asyncio.wait_for(task, 5)
    assert OTHER not in dialer.targets


@pytest.mark.parametrize("check_every_s", [60], indirect=True)
async def test_a_change_of_the_network_is_looked_at_at_once(network, watched, monkeypatch):
    _, _, task = watched
    monkeypatch.setattr(liveness, "path_of", lambda _: Path.GONE)
    assert not (await asyncio.wait({task}, timeout=0.1))[0]
    network._event.set()
    with pytest.raises(NetworkChangedError):
        await asyncio.wait_for(task, 5)


async def test_after_standing_still_less_silence_is_enough(watched, monkeypatch):
    session, dialer, task = watched
    session.silent_s = liveness.DISTRUSTED_AFTER_S + 0.1
    await asyncio.wait({task}, timeout=0.1)
    assert dialer.asked == 0
    monkeypatch.setattr(liveness, "robot_time", lambda: robot_time() + 30.0)
    dialer.answers.set()
    with pytest.raises(ServerSilentError):
        await asyncio.wait_for(task, 5)
