"""TCP connections to the server: names and addresses, attempts side by side, a proxy, and the kernel's news."""

import asyncio
import os
import socket
import threading
from contextlib import contextmanager

import pytest
from fake_cloud import eventually
from fake_proxy import PASSWORD, SECRET, USER, FakeProxy
from namespaces import ip
from robotether_agent.net import tcp
from robotether_agent.net.happy_eyeballs import HappyEyeballs, after, combined_problem
from robotether_agent.net.http_proxy import Proxy, ask_for, proxy_of, refusal, request
from robotether_agent.net.netlink import listening
from robotether_agent.net.tcp import (
    Resolver,
    connect,
    interleaved,
    is_established,
    is_stuck,
    prepare,
)
from robotether_agent.problems import NoAnswerError, ServerBusyError, ServerUnreachableError
from ssh_ports import SshPort

FOUR = [(socket.AF_INET, (f"192.0.2.{number}", 22)) for number in (1, 2)]
SIX = [(socket.AF_INET6, (f"2001:db8::{number}", 22, 0, 0)) for number in (1, 2, 3)]


def option(connection, number):
    return connection.getsockopt(socket.IPPROTO_TCP, number)


def test_a_dead_path_is_given_up_in_seconds(connection):
    prepare(connection)
    assert option(connection, socket.TCP_NODELAY)
    assert option(connection, tcp.TCP_USER_TIMEOUT) == tcp.USER_TIMEOUT_MS


def test_a_live_path_is_not_stuck(connection):
    connection.send(b"hello")
    assert not is_stuck(connection)
    assert is_established(connection)
    connection.close()
    assert not is_stuck(connection)
    assert not is_established(connection)


class NameService:
    def __init__(self):
        self.answer = FOUR
        self.free = threading.Event()
        self.free.set()
        self.asked = 0

    def __call__(self, host, port):
        self.asked += 1
        answer = self.answer
        assert self.free.wait(10)
        if isinstance(answer, OSError):
            raise answer
        return answer

    @contextmanager
    def hanging(self):
        self.free.clear()
        try:
            yield
        finally:
            self.free.set()


@pytest.fixture
def names():
    return NameService()


def test_families_take_turns():
    """The resolver's first choice comes first, then the other family, as far as they go."""
    assert interleaved(SIX + FOUR) == [SIX[0], FOUR[0], SIX[1], FOUR[1], SIX[2]]
    assert interleaved(FOUR) == FOUR


async def test_an_answer_that_comes_late_counts_the_next_time(names):
    """What a hanging question brings at last is used when the next one hangs."""
    known = Resolver(names)
    await known.addresses("h", 22)
    names.answer = SIX
    with names.hanging():
        assert await known.addresses("h", 22) == FOUR
    deadline = asyncio.get_running_loop().time() + 5
    while known._last["h", 22] != SIX:
        assert asyncio.get_running_loop().time() < deadline
        await asyncio.sleep(0.01)
    names.answer = OSError("gone")
    assert await known.addresses("h", 22) == SIX


async def test_questions_that_hang_do_not_pile_up(names, monkeypatch):
    monkeypatch.setattr(tcp, "CACHED_TIMEOUT_S", 0.01)
    known = Resolver(names)
    await known.addresses("h", 22)
    with names.hanging():
        for _ in range(3 * tcp.THREADS):
            await known.addresses("h", 22)
        assert names.asked == 1 + tcp.THREADS


async def test_a_name_service_that_never_answered(names, monkeypatch):
    monkeypatch.setattr(tcp, "RESOLVE_TIMEOUT_S", 0.05)
    with names.hanging(), pytest.raises(OSError, match="no answer from the name service"):
        await Resolver(names).addresses("h", 22)


def at(*addresses):
    return Resolver(lambda _, port: [(socket.AF_INET, (address, port)) for address in addresses])


async def test_an_address_that_refuses_is_passed_over():
    async with SshPort() as door:
        with await connect("h", door.port, at("127.0.0.2", "127.0.0.1"), "it") as connection:
            assert connection.getpeername() == ("127.0.0.1", door.port)
            assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


class Attempts:
    def __init__(self):
        self.started = []
        self.ended = []
        self.dropped = []

    def that(self, name, outcome=None, *, when=None):
        async def attempt():
            self.started.append(name)
            try:
                await (when or asyncio.Event()).wait() if when or outcome is None else None
                if isinstance(outcome, Exception):
                    raise outcome
                return name
            finally:
                self.ended.append(name)

        return attempt


def never():
    return asyncio.Event().wait()


@pytest.fixture
def attempts():
    return Attempts()


async def test_two_that_work_in_the_same_moment(attempts):
    now = asyncio.Event()
    ways = [attempts.that(name, when=now) for name in ("one", "other")]
    race = HappyEyeballs(ways, pause=after(0), drop=attempts.dropped.append)
    winner = asyncio.ensure_future(race.winner())
    await eventually(lambda: len(attempts.started) == 2, lambda: "both have started")
    now.set()
    assert {await asyncio.wait_for(winner, 5), *attempts.dropped} == {"one", "other"}


async def test_a_defect_is_not_hidden(attempts):
    ways = [attempts.that("broken", ValueError("a defect")), attempts.that("second", "works")]
    with pytest.raises(ValueError, match="a defect"):
        await HappyEyeballs(ways, pause=never, drop=attempts.dropped.append).winner()


@pytest.mark.parametrize("turns", range(12))
async def test_cancelled_at_any_moment_nothing_that_came_is_lost(attempts, turns):
    ways = [attempts.that("silent"), attempts.that("works", "works")]
    race = HappyEyeballs(ways, pause=after(0), drop=attempts.dropped.append)
    racing = asyncio.ensure_future(race.winner())
    for _ in range(turns):
        await asyncio.sleep(0)
    racing.cancel()
    [won] = await asyncio.gather(racing, return_exceptions=True)
    await asyncio.sleep(0)
    came = ["works"] if "works" in attempts.ended else []
    assert attempts.dropped == ([] if won == "works" else came)


async def test_a_busy_server_ends_the_attempts(attempts):
    """Its other ports are not asked: they lead to the same server."""
    ways = [attempts.that("busy", ServerBusyError("full")), attempts.that("second", "works")]
    with pytest.raises(ServerBusyError, match="full"):
        await HappyEyeballs(ways, pause=after(10), drop=attempts.dropped.append).winner()
    assert attempts.started == ["busy"]


@pytest.mark.parametrize(
    ("problems", "kind", "words"),
    [
        ([], NoAnswerError, "nothing answers"),
        ([NoAnswerError("a"), NoAnswerError("a"), NoAnswerError("b")], NoAnswerError, "a; b"),
        ([NoAnswerError("a"), ServerUnreachableError("b")], ServerUnreachableError, "b"),
        (
            [NoAnswerError("a"), ServerUnreachableError("b"), ServerBusyError("c")],
            ServerBusyError,
            "c",
        ),
    ],
)
def test_of_several_problems_the_servers_own_word_counts(problems, kind, words):
    """A refusal counts more than the silence beside it, since it waits longer; that it is busy explains most."""
    found = combined_problem(problems)
    assert (type(found), found.message.removeprefix("cannot connect: ")) == (kind, words)


def test_the_password_is_in_no_text():
    proxy = Proxy("proxy.example", 8080, USER, PASSWORD)
    assert PASSWORD not in f"{proxy} {proxy!r}"
    assert SECRET in request(proxy, "h", 443).decode()


@pytest.mark.parametrize(
    ("head", "kind", "words"),
    [
        (b"HTTP/1.1 200 Connection established\r\n\r\n", None, ""),
        (b"HTTP/1.1 407 Who?\r\n\r\n", ServerUnreachableError, "USER:PASSWORD"),
        (b"HTTP/1.1 504 Too late\r\n\r\n", NoAnswerError, "504 Too late"),
        (b"HTTP/1.1 403 \x1b[31m\r\n\r\n", ServerUnreachableError, "403"),
        (b"SSH-2.0-OpenSSH_9.2\r\n\r\n", ServerUnreachableError, "not HTTP"),
        (b"HTTP/1.1 200 " + b"x" * 9000, ServerUnreachableError, "not HTTP"),
    ],
)
def test_each_answer_is_told(head, kind, words):
    problem = refusal(head, Proxy("p", 1), "h port 22")
    if kind is None:
        assert problem is None
        return
    assert isinstance(problem, kind)
    assert words in str(problem)
    assert "\x1b" not in str(problem)


async def ask(url):
    proxy = proxy_of(url)
    with await connect(proxy.host, proxy.port, Resolver(), "the proxy") as connection:
        await ask_for(connection, proxy, "127.0.0.1", 9)


@pytest.mark.parametrize(
    ("mode", "kind", "words"),
    [
        ("closes", ServerUnreachableError, "closes the connection"),
        ("silent", NoAnswerError, "does not answer"),
    ],
)
async def test_a_proxy_without_an_answer_is_named(monkeypatch, mode, kind, words):
    monkeypatch.setattr("robotether_agent.net.http_proxy.TIMEOUT_S", 0.1)
    async with FakeProxy(mode) as proxy:
        with pytest.raises(kind, match=words) as caught:
            await ask(proxy.url)
        assert f"the HTTP proxy 127.0.0.1 port {proxy.port}" in str(caught.value)


@pytest.mark.skipif(os.geteuid() != 0, reason="changing an interface needs root")
async def test_the_kernel_is_heard():
    address = "127.213.17.1/32"
    with listening() as network:
        await asyncio.to_thread(ip, "address", "add", address, "dev", "lo")
        try:
            await asyncio.wait_for(network.changed(), 5)
        finally:
            await asyncio.to_thread(ip, "address", "del", address, "dev", "lo")
