"""Uplinks: who gets which addresses, and real traffic through several at once."""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from ipaddress import IPv4Address, IPv4Network
from itertools import islice
from pathlib import Path

import namespaces
import pytest
from link import why_not_here
from paper.profiles import PLAIN, Profile
from paper.uplinks import PLACES, Addresses, Uplink, places, uplinks

needs_root = pytest.mark.skipif(bool(why_not_here()), reason=why_not_here() or "-")
NEAR = Profile(name="10 ms", ping_ms=10, up_mbit_s=20.0, down_mbit_s=20.0)
FAR = Profile(name="40 ms", ping_ms=40)
CARRIERS = IPv4Network("100.64.0.0/10")


def test_places_have_no_address_in_common() -> None:
    """Each one's block holds all of its addresses, and the next one's begins behind it."""
    one, other = Addresses(7), Addresses(8)
    own = {one.gateway, *one.inside, *one.cable}
    assert len(own) == 5
    assert all(IPv4Address(address) in IPv4Network(one.block) for address in own)
    assert not IPv4Network(one.block).overlaps(IPv4Network(other.block))


@pytest.mark.parametrize("place", [0, PLACES - 1])
def test_all_places_are_within_the_carriers_network(place: int) -> None:
    """None takes an address that somebody could have, and a device's name is no longer than the kernel takes."""
    assert IPv4Network(Addresses(place).block).subnet_of(CARRIERS)
    assert len(Addresses(place).peer) < 16


@pytest.mark.parametrize("pid", [1, 4_194_303])
def test_a_process_finds_every_place(pid: int) -> None:
    """From its own first one on, and around."""
    found = list(places(pid))
    assert found[0] == pid * 8 % PLACES
    assert sorted(found) == list(range(PLACES))
    assert list(islice(places(pid + 1), 1)) != found[:8]


def own_address() -> str:
    """An address of this machine that is none of loopback's."""
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as probe:
        probe.connect(("192.0.2.1", 9))
        return str(probe.getsockname()[0])


@contextmanager
def echoing() -> Iterator[int]:
    """A UDP echo on this machine, which puts the asker's address in front; gives its port."""
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as echo:
        echo.bind(("", 0))

        def serve() -> None:
            while (data := echo.recvfrom(2048))[0] != b"end":
                echo.sendto(data[1][0].encode() + b" " + data[0], data[1])

        thread = threading.Thread(target=serve)
        thread.start()
        yield echo.getsockname()[1]
        with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as last:
            last.sendto(b"end", ("127.0.0.1", echo.getsockname()[1]))
        thread.join()


def ask(uplink: Uplink, port: int) -> tuple[float, str]:
    """The round trip in ms from inside, and the address that this machine saw."""
    with uplink.inside.entered():
        here = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with closing(here):
        here.settimeout(5)
        sent = time.perf_counter()
        here.sendto(b"x" * 100, (uplink.machine, port))
        answer = here.recv(2048).decode()
        return (time.perf_counter() - sent) * 1000, answer.split()[0]


def made_by_this() -> list[str]:
    """Namespaces of this process, but for the browser's, and cables' ends of its first places."""
    named = [path.name for path in namespaces.PLACE.glob(f"{namespaces.PREFIX}-{os.getpid()}-*")]
    devices = [Addresses(place).device for place in islice(places(os.getpid()), 4)]
    standing = [name for name in devices if Path("/sys/class/net", name).exists()]
    return [name for name in named + standing if not name.endswith("-browser")]


@needs_root
def test_uplinks_stand_beside_each_other() -> None:
    """Each has its own delay, and the machine sees each one's own address; afterwards nothing is left."""
    with echoing() as port, uplinks([NEAR, PLAIN, FAR], own_address()) as made:
        for uplink in made:
            answers = [ask(uplink, port) for _ in range(10)]
            fastest = min(answers)[0]
            assert uplink.profile.ping_ms <= fastest < uplink.profile.ping_ms + 2
            assert {seen for _, seen in answers} == {uplink.inside.address}
    assert made_by_this() == []


@needs_root
def test_packets_are_counted() -> None:
    """By the link; a cable alone has no counts."""
    with echoing() as port, uplinks([FAR, PLAIN], own_address()) as [far, plain]:
        ask(far, port)
        ask(plain, port)
        assert [counts.passed for counts in far.counts()] == [1, 1]
        assert [counts.passed for counts in plain.counts()] == [0, 0]


@needs_root
def test_the_inside_can_get_another_address_and_the_first_again() -> None:
    """The machine reaches it there, each time."""
    with echoing() as port, uplinks([NEAR], own_address()) as [uplink]:
        first = uplink.inside.address
        seen = [ask(uplink, port)[1]]
        for _ in range(2):
            uplink.readdress()
            seen.append(ask(uplink, port)[1])
            assert seen[-1] == uplink.inside.address
    assert seen[0] == seen[2] == first != seen[1]


@needs_root
def test_what_was_made_goes_when_one_cannot_be_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """The failure is told, and no network is left."""
    monkeypatch.setattr("paper.uplinks.LINK_PREFIX", 33)
    with (
        pytest.raises(RuntimeError, match="cannot run ip"),
        uplinks([PLAIN, NEAR], own_address()),
    ):
        pytest.fail("it was made")
    assert made_by_this() == []
