"""A server with a slow line: operators and robots in two namespaces whose packets share one cable of so many bit/s.

    with server_line(5, "172.17.0.1") as line:
        line.operators.inside, line.robots.inside

The cable is shaped by the kernel's token buckets, one each way, in front of the machine at which the stack's published
ports answer: as if the server itself had this line and nobody else's were slow. Whatever else uses the server is not
slowed down, so that it also works beside others. Needs root; IPv4 alone.
"""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from ipaddress import IPv4Network
from itertools import count

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
class LineCounts:
    """What a line has carried and dropped, each way; bytes with the headers of IP and Ethernet."""

    to_server_bytes: int
    from_server_bytes: int
    to_server_dropped: int
    from_server_dropped: int

    def since(self, before: LineCounts) -> dict[str, int]:
        """What came to it after `before`, as JSON carries it."""
        earlier = asdict(before)
        return {name: value - earlier[name] for name, value in asdict(self).items()}


@dataclass(frozen=True)
class ServerLine:
    """Both ends that are there inside `with`, and the two devices whose queues are the line."""

    operators: Uplink
    robots: Uplink
    # As tc names them: where it is, and its name.
    to_server: tuple[str, ...]
    from_server: tuple[str, ...]

    def counts(self) -> LineCounts:
        """What passed so far, and what found the queue full."""
        up, down = shaped(self.to_server), shaped(self.from_server)
        return LineCounts(up["bytes"], down["bytes"], up["drops"], down["drops"])


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
        to_server, from_server = ("-n", line.name, CABLE), (addresses.device,)
        shape(to_server, profile.up)
        shape(from_server, profile.down)
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


def shape(device: tuple[str, ...], limit: Shape) -> None:
    """Let what leaves by a device pass no faster than it says; what finds the queue full is dropped."""
    assert limit.rate_bit_s is not None
    rate, queue = f"{limit.rate_bit_s:.0f}bit", str(limit.queue_bytes)
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
