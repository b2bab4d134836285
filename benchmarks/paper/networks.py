"""Networks of robots and operators: namespaces whose only way out is an emulated link to this machine.

    with uplinks([SLOW_4G, PLAIN], "172.17.0.1") as (slow, plain):
        slow.inside.run("ping", "-c1", slow.machine)

A profile is what one end, a robot or an operator, has between itself and the server: those of the paper's Table 2,
whose ping is that of both ways, and worse ones. `server_line` puts the server behind a slow line instead. Packets are
routed and never translated, so that the server sees the address that the robot has; published ports are reached by the
kernel's own translation, as from outside, and not by a proxy process. Needs root; adds nothing to the machine's
firewall. IPv4 alone.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from ipaddress import IPv4Address, IPv4Network
from itertools import chain, count
from typing import Any

import namespaces
from link import Link, Shape
from namespaces import Namespace, ip

# What a home router or a base station keeps for one user, at least; and half a second of what the link carries.
LEAST_QUEUE_BYTES, QUEUE_S = 64 * 1024, 0.5
# The addresses that carriers give to phones behind their translation (RFC 6598): 16 for each uplink.
FIRST, BLOCK, SLOTS = IPv4Address("100.64.0.0"), 16, 1 << 18
# Where a process looks first for free places; others may stand there, then it looks on.
SLOTS_A_PROCESS = 8
LINK_PREFIX, CABLE_PREFIX = 29, 30
CABLE = "machine"
# Making one is mostly waiting for the kernel and for the link's process.
AT_ONCE = 4
_numbers = count(1)
# What passes at full speed before the rate holds: some ten packets.
BURST_BYTES = 16 * 1024
# Each end has four of the addresses behind the cable.
END_PREFIX = 30


@dataclass(frozen=True, kw_only=True)
class Profile:
    """One network; `None` for a rate is as fast as this machine is."""

    name: str
    ping_ms: float = 0.0
    down_mbit_s: float | None = None
    up_mbit_s: float | None = None
    # Each packet is up to this much later or earlier, in order.
    jitter_ms: float = 0.0
    # The share of packets that is lost, each way.
    loss: float = 0.0

    @property
    def is_plain(self) -> bool:
        return self == Profile(name=self.name)

    def shape(self, mbit_s: float | None) -> Shape:
        """Of the way at this rate, up or down."""
        rate_bit_s = None if mbit_s is None else mbit_s * 1e6
        queue = LEAST_QUEUE_BYTES if rate_bit_s is None else int(rate_bit_s / 8 * QUEUE_S)
        return Shape(
            rate_bit_s=rate_bit_s,
            delay_s=self.ping_ms / 2000,
            jitter_s=self.jitter_ms / 2000,
            queue_bytes=max(LEAST_QUEUE_BYTES, queue),
            loss=self.loss,
        )


PLAIN = Profile(name="no emulation")


TABLE_2 = (
    Profile(name="fixed, 94/89 Mbit/s", ping_ms=7, down_mbit_s=94.41, up_mbit_s=89.44),
    Profile(name="fixed, 288/113 Mbit/s", ping_ms=7, down_mbit_s=287.77, up_mbit_s=113.18),
    Profile(name="4G, 7/5 Mbit/s", ping_ms=38, down_mbit_s=7.13, up_mbit_s=4.97),
    Profile(name="4G, 31/9 Mbit/s", ping_ms=19, down_mbit_s=31.13, up_mbit_s=8.91),
    Profile(name="4G, 80/19 Mbit/s", ping_ms=15, down_mbit_s=80.07, up_mbit_s=19.36),
    Profile(name="4G, 5.4/5.4 Mbit/s", ping_ms=31, down_mbit_s=5.41, up_mbit_s=5.36),
)


FIXED, _, SLOW_4G, _, _, OTHER_4G = TABLE_2


# A third each, as the mixed runs want.
MIXED = (FIXED, SLOW_4G, OTHER_4G)


# Round trips of 80 ± 20 ms with 2 % loss, and 300 ± 100 ms with 10 % and 500 kbit/s.
LOSSY = Profile(name="80 ± 20 ms, 2 % loss", ping_ms=80, jitter_ms=20, loss=0.02)


WORST = Profile(
    name="300 ± 100 ms, 10 % loss, 500 kbit/s",
    ping_ms=300,
    jitter_ms=100,
    loss=0.1,
    down_mbit_s=0.5,
    up_mbit_s=0.5,
)


class Addresses:
    """What one uplink has of the machine's addresses, by its place."""

    def __init__(self, slot: int) -> None:
        def at(number: int) -> str:
            return str(FIRST + slot * BLOCK + number)

        # The machine's end of the cable; that no two have this name keeps two uplinks from one place.
        self.device = f"rtup{slot}"
        # The cable's other end, until it is in a namespace.
        self.peer = f"{self.device}p"
        # Those that the inside may have at the link, one after the other; the link's other end.
        self.inside, self.gateway = (at(1), at(3)), at(2)
        # All of them, as a route takes them.
        self.block = f"{at(0)}/28"
        # The machine's and the uplink's end of the cable between them.
        self.cable = at(9), at(10)


def slots(pid: int) -> Iterator[int]:
    """All places, from the one on that is this process's first."""
    first = pid * SLOTS_A_PROCESS % SLOTS
    return chain(range(first, SLOTS), range(first))


class Uplink:
    """One network; it is there inside `with` only. A plain one is a cable alone, with no process in it."""

    def __init__(self, profile: Profile, machine: str) -> None:
        self.profile = profile
        # This machine's address as seen from inside.
        self.machine = machine
        self.inside: Namespace
        self._addresses: Addresses
        self._made = ExitStack()

    def __enter__(self) -> Uplink:
        with ExitStack() as made:
            if self.profile.is_plain:
                self._lay_plain(made)
            else:
                self._lay_link(made)
            self._made = made.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._made.close()

    def _lay_plain(self, made: ExitStack) -> None:
        self._addresses = allot(made)
        self.inside = new_namespace(made, "plain", self._addresses.cable[1])
        join(self.inside, self._addresses)

    def _lay_link(self, made: ExitStack) -> None:
        self._addresses = allot(made)
        link = Link(
            up=self.profile.shape(self.profile.up_mbit_s),
            down=self.profile.shape(self.profile.down_mbit_s),
            seed=next(_numbers),
            robot_address=self._addresses.inside[0],
            server_address=self._addresses.gateway,
            prefix_length=LINK_PREFIX,
        )
        made.enter_context(link)
        self.inside = link.robot
        join(link.server, self._addresses)
        link.server.sysctl("net.ipv4.ip_forward", "1")
        switch_ipv6_off(link.robot)
        ip("-n", link.robot.name, "route", "add", "default", "via", self._addresses.gateway)


def allot(made: ExitStack) -> Addresses:
    """Take a free place by making its cable, both ends still here; the kernel gives each name once."""
    for slot in slots(os.getpid()):
        addresses = Addresses(slot)
        ends = (addresses.device, "type", "veth", "peer", "name", addresses.peer)
        done = subprocess.run(
            ["ip", "link", "add", *ends], capture_output=True, text=True, check=False
        )
        if done.returncode == 0:
            made.callback(unplug, addresses.device, socket.if_nametoindex(addresses.device))
            return addresses
        if "File exists" not in done.stderr:
            raise RuntimeError(f"cannot lay a cable for an uplink: {done.stderr.strip()}")
    raise RuntimeError(f"cannot make an uplink: all {SLOTS} places are taken")


def unplug(device: str, index: int) -> None:
    """Remove the cable, if it has not gone with its namespace; one of that name may be another process's by now."""
    try:
        is_ours = socket.if_nametoindex(device) == index
    except OSError:
        return
    if is_ours:
        subprocess.run(["ip", "link", "delete", device], capture_output=True, check=False)


def join(end: Namespace, addresses: Addresses) -> None:
    """Put the cable's other end into a namespace, and make the ways there and back."""
    here, there = addresses.cable
    switch_ipv6_off(end)
    ip("link", "set", addresses.peer, "netns", end.name, "name", CABLE)
    ip("address", "add", f"{here}/{CABLE_PREFIX}", "dev", addresses.device)
    ip("link", "set", addresses.device, "up")
    ip("-n", end.name, "address", "add", f"{there}/{CABLE_PREFIX}", "dev", CABLE)
    ip("-n", end.name, "link", "set", CABLE, "up")
    ip("-n", end.name, "route", "add", "default", "via", here)
    ip("route", "add", addresses.block, "via", there, "dev", addresses.device)


def made_in(namespace: Namespace) -> dict[str, Any]:
    """What has a TCPConnector make its sockets inside a namespace, where they stay; names are looked up outside."""

    def make(address: Any) -> socket.socket:
        family, kind, protocol, *_ = address
        with namespace.entered():
            return socket.socket(family, kind, protocol)

    return {"socket_factory": make}


def switch_ipv6_off(namespace: Namespace) -> None:
    """Also for interfaces to come, which would else get a second address a moment after they are up."""
    for which in ("all", "default"):
        namespace.sysctl(f"net.ipv6.conf.{which}.disable_ipv6", "1")


@contextmanager
def uplinks(profiles: Sequence[Profile], machine: str) -> Iterator[list[Uplink]]:
    """Make one for each profile, in their order, and remove them all; `machine` is this machine's address for them."""
    wanted = [Uplink(profile, machine) for profile in profiles]
    with ExitStack() as made, ThreadPoolExecutor(AT_ONCE) as threads:
        # All that were made are removed, also when one of them cannot be.
        started = [threads.submit(one.__enter__) for one in wanted]
        wait(started)
        for one, future in zip(wanted, started, strict=True):
            if future.exception() is None:
                made.push(one)
        for future in started:
            future.result()
        yield wanted


@dataclass(frozen=True)
class ServerLine:
    """Both ends that are there inside `with`, and the two devices whose queues are the line."""

    operators: Uplink
    robots: Uplink
    # As tc names them: where it is, and its name.
    to_server: tuple[str, ...]
    from_server: tuple[str, ...]

    def counts(self) -> dict[str, int]:
        """What passed so far, in bytes with the headers of IP and Ethernet, and what found the queue full."""
        ways = {"to_server": self.to_server, "from_server": self.from_server}
        shaped_ways = {way: shaped(device) for way, device in ways.items()}
        return {
            f"{way}_{what}": counts[member]
            for way, counts in shaped_ways.items()
            for what, member in (("bytes", "bytes"), ("dropped", "drops"))
        }


@contextmanager
def server_line(mbit_s: float, machine: str) -> Iterator[ServerLine]:
    """Make it, and remove it; `machine` is this machine's address for both ends."""
    namespaces.sweep()
    name = f"server's line of {mbit_s:g} Mbit/s"
    profile = Profile(name=name, down_mbit_s=mbit_s, up_mbit_s=mbit_s)
    with ExitStack() as made:
        addresses = allot(made)
        line = new_namespace(made, "line", addresses.cable[1])
        join(line, addresses)
        line.sysctl("net.ipv4.ip_forward", "1")
        to_server, from_server = ("-n", line.name, CABLE), (addresses.device,)
        limit(to_server, profile.shape(mbit_s))
        limit(from_server, profile.shape(mbit_s))
        ends = []
        for name, network in zip(
            ("operators", "robots"),
            IPv4Network(addresses.block).subnets(new_prefix=END_PREFIX),
            strict=False,
        ):
            uplink = Uplink(profile, machine)
            uplink.inside = _behind(made, line, name, network)
            ends.append(uplink)
        yield ServerLine(*ends, to_server, from_server)


def limit(device: tuple[str, ...], to: Shape) -> None:
    """Let what leaves by a device pass no faster than it says; what finds the queue full is dropped."""
    assert to.rate_bit_s is not None
    rate, queue = f"{to.rate_bit_s:.0f}bit", str(to.queue_bytes)
    bucket = ("tbf", "rate", rate, "burst", str(BURST_BYTES), "limit", queue)
    *where, name = device
    _tc(*where, "qdisc", "add", "dev", name, "root", *bucket)


def shaped(device: tuple[str, ...]) -> dict[str, int]:
    """What a shaped device counts: `bytes` that left, `drops` of packets."""
    *where, name = device
    [counts] = json.loads(_tc(*where, "-s", "-j", "qdisc", "show", "dev", name))
    return {one: int(counts[one]) for one in ("bytes", "drops")}


def _tc(*words: str) -> str:
    done = subprocess.run(["tc", *words], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"cannot run tc {' '.join(words)}: {done.stderr.strip()}")
    return done.stdout


def _behind(made: ExitStack, line: Namespace, name: str, network: IPv4Network) -> Namespace:
    """Make a namespace on the other side of the line, at full speed up to there."""
    gateway, address = (str(host) for host in network.hosts())
    inside = new_namespace(made, name, address)
    switch_ipv6_off(inside)
    ends = ((line, gateway, name), (inside, address, CABLE))
    ip("-n", line.name, "link", "add", "name", name, "type", "veth",
       "peer", "name", CABLE, "netns", inside.name)  # fmt: skip
    for end, own, device in ends:
        ip("-n", end.name, "address", "add", f"{own}/{END_PREFIX}", "dev", device)
        ip("-n", end.name, "link", "set", device, "up")
    ip("-n", inside.name, "route", "add", "default", "via", gateway)
    return inside


def new_namespace(made: ExitStack, name: str, address: str) -> Namespace:
    new = Namespace(f"{namespaces.PREFIX}-{os.getpid()}-{next(_numbers)}-{name}", address)
    made.callback(namespaces.remove, new.name)
    namespaces.make(new)
    return new
