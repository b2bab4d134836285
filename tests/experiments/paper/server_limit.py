"""A server with a slow line: operators and robots in two namespaces whose packets share one cable of so many bit/s.

    with server_line(5, "172.17.0.1") as line:
        line.operators.inside, line.robots.inside

The cable is shaped by the kernel's token buckets, one each way, in front of the machine at which the stack's published
ports answer: as if the server itself had this line and nobody else's were slow. Whatever else uses the server is not
slowed down, so that it also works beside others. Needs root; IPv4 alone.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from ipaddress import IPv4Network
from itertools import count
from pathlib import Path

import namespaces
from link import Shape
from namespaces import Namespace, ip

from paper.profiles import Profile
from paper.uplinks import CABLE, Uplink, allot, join, switch_ipv6_off

# What passes at full speed before the rate holds: some ten packets.
BURST_BYTES = 16 * 1024
# Each end has four of the addresses behind the cable.
END_PREFIX = 30
_numbers = count(1)


@dataclass(frozen=True)
class ServerLine:
    """Both ends that are there inside `with`, and the cable's own count of bytes."""

    operators: Uplink
    robots: Uplink
    device: str

    def passed_bytes(self) -> tuple[int, int]:
        """What went to the server so far and what came from it, with the headers of IP and Ethernet."""
        return self._passed("rx"), self._passed("tx")

    def _passed(self, way: str) -> int:
        return int(Path("/sys/class/net", self.device, "statistics", f"{way}_bytes").read_text())


def line_profile(mbit_s: float) -> Profile:
    """The server's line as a profile."""
    name = f"server's line of {mbit_s:g} Mbit/s"
    return Profile(name=name, down_mbit_s=mbit_s, up_mbit_s=mbit_s)


@contextmanager
def server_line(mbit_s: float, machine: str) -> Iterator[ServerLine]:
    """Make it, and remove it; `machine` is this machine's address for both ends."""
    namespaces.sweep()
    profile = line_profile(mbit_s)
    with ExitStack() as made:
        addresses = allot(made)
        line = _namespace(made, "line", addresses.cable[1])
        join(line, addresses)
        line.sysctl("net.ipv4.ip_forward", "1")
        # The machine's end is the way from the server, the other one that to it.
        shape((), addresses.device, profile.down)
        shape(("-n", line.name), CABLE, profile.up)
        ends = []
        for name, network in zip(
            ("operators", "robots"),
            IPv4Network(addresses.block).subnets(new_prefix=END_PREFIX),
            strict=False,
        ):
            uplink = Uplink(profile, machine)
            uplink.inside = _behind(made, line, name, network)
            ends.append(uplink)
        yield ServerLine(*ends, device=addresses.device)


def shape(where: tuple[str, ...], device: str, limit: Shape) -> None:
    """Let what leaves by a device pass no faster than it says; what finds the queue full is dropped."""
    assert limit.rate_bit_s is not None
    rate, queue = f"{limit.rate_bit_s:.0f}bit", str(limit.queue_bytes)
    bucket = ("tbf", "rate", rate, "burst", str(BURST_BYTES), "limit", queue)
    command = ["tc", *where, "qdisc", "add", "dev", device, "root", *bucket]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"cannot limit {device} to {rate}: {done.stderr.strip()}")


def _behind(made: ExitStack, line: Namespace, name: str, network: IPv4Network) -> Namespace:
    """Make a namespace on the other side of the line, at full speed up to there."""
    gateway, address = (str(host) for host in network.hosts())
    inside = _namespace(made, name, address)
    switch_ipv6_off(inside)
    ends = ((line, gateway, name), (inside, address, CABLE))
    ip("-n", line.name, "link", "add", "name", name, "type", "veth",
       "peer", "name", CABLE, "netns", inside.name)  # fmt: skip
    for end, own, device in ends:
        ip("-n", end.name, "address", "add", f"{own}/{END_PREFIX}", "dev", device)
        ip("-n", end.name, "link", "set", device, "up")
    ip("-n", inside.name, "route", "add", "default", "via", gateway)
    return inside


def _namespace(made: ExitStack, name: str, address: str) -> Namespace:
    new = Namespace(f"{namespaces.PREFIX}-{os.getpid()}-{next(_numbers)}-{name}", address)
    made.callback(namespaces.remove, new.name)
    namespaces.make(new)
    return new
