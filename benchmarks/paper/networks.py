"""Networks of robots and operators: namespaces whose only way out is a cable to this machine.

    with uplinks(2, "172.17.0.1") as (one, other):
        one.inside.run("ping", "-c1", one.machine)

`server_line` puts the server behind a slow line. Packets are routed and never translated, so that the server sees the
address that the robot has; published ports are reached by the kernel's own translation, as from outside, and not by a
proxy process. Needs root; adds nothing to the machine's firewall. IPv4 alone.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from ipaddress import IPv4Address, IPv4Network
from itertools import chain, count
from typing import Any

import namespaces
from namespaces import Namespace, ip

# What a home router or a base station keeps for one user, at least; and half a second of what the link carries.
LEAST_QUEUE_BYTES, QUEUE_S = 64 * 1024, 0.5
# The addresses that carriers give to phones behind their translation (RFC 6598): 16 for each uplink.
FIRST, BLOCK, SLOTS = IPv4Address("100.64.0.0"), 16, 1 << 18
# Where a process looks first for free places; others may stand there, then it looks on.
SLOTS_A_PROCESS = 8
CABLE_PREFIX = 30
CABLE = "machine"
_numbers = count(1)
# What passes at full speed before the rate holds: some ten packets.
BURST_BYTES = 16 * 1024
# Each end has four of the addresses behind the cable.
END_PREFIX = 30


class Addresses:
    """What one uplink has of the machine's addresses, by its place."""

    def __init__(self, slot: int) -> None:
        def at(number: int) -> str:
            return str(FIRST + slot * BLOCK + number)

        # The machine's end of the cable; that no two have this name keeps two uplinks from one place.
        self.device = f"rtup{slot}"
        # The cable's other end, until it is in a namespace.
        self.peer = f"{self.device}p"
        # All of them, as a route takes them.
        self.block = f"{at(0)}/28"
        # The machine's and the uplink's end of the cable between them.
        self.cable = at(9), at(10)


def slots(pid: int) -> Iterator[int]:
    """All places, from the one on that is this process's first."""
    first = pid * SLOTS_A_PROCESS % SLOTS
    return chain(range(first, SLOTS), range(first))


@dataclass(frozen=True)
class Uplink:
    """One network."""

    inside: Namespace
    # This machine's address as seen from inside.
    machine: str


@contextmanager
def uplinks(how_many: int, machine: str) -> Iterator[list[Uplink]]:
    """Make so many, and remove them all; `machine` is this machine's address for them."""
    namespaces.sweep()
    with ExitStack() as made:
        yield [_uplink(made, machine) for _ in range(how_many)]


def _uplink(made: ExitStack, machine: str) -> Uplink:
    addresses = allot(made)
    inside = new_namespace(made, "plain", addresses.cable[1])
    join(inside, addresses)
    return Uplink(inside, machine)


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


@dataclass(frozen=True)
class ServerLine:
    """Both ends that are there inside `with`, and the two devices whose queues are the line."""

    mbit_s: float
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
    with ExitStack() as made:
        addresses = allot(made)
        line = new_namespace(made, "line", addresses.cable[1])
        join(line, addresses)
        line.sysctl("net.ipv4.ip_forward", "1")
        to_server, from_server = ("-n", line.name, CABLE), (addresses.device,)
        limit(to_server, mbit_s)
        limit(from_server, mbit_s)
        networks = IPv4Network(addresses.block).subnets(new_prefix=END_PREFIX)
        ends = [
            Uplink(_behind(made, line, name, network), machine)
            for name, network in zip(("operators", "robots"), networks, strict=False)
        ]
        yield ServerLine(mbit_s, *ends, to_server, from_server)


def limit(device: tuple[str, ...], mbit_s: float) -> None:
    """Let what leaves by a device pass no faster than that; what finds the queue full is dropped."""
    queue = max(LEAST_QUEUE_BYTES, int(mbit_s * 1e6 / 8 * QUEUE_S))
    bucket = (
        "tbf",
        "rate",
        f"{mbit_s * 1e6:.0f}bit",
        "burst",
        str(BURST_BYTES),
        "limit",
        str(queue),
    )
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
