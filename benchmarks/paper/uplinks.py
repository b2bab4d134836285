"""Networks of robots and operators: namespaces whose only way out is an emulated link to this machine.

    with uplinks([SLOW_4G, PLAIN], "172.17.0.1") as (slow, plain):
        slow.inside.run("ping", "-c1", slow.machine)

Used by world.py, which says at which of this machine's addresses the stack's published ports answer. Packets are routed
and never translated, so that the server sees the address that the robot has; the published ports are reached by the
kernel's own translation, as from outside, and not by a proxy process. Needs root; adds nothing to the machine's
firewall. IPv4 alone.
"""

from __future__ import annotations

import os
import socket
import subprocess
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from ipaddress import IPv4Address
from itertools import chain, count
from types import TracebackType

import namespaces
from link import DEVICE as LINK_DEVICE
from link import Counts, Link, Shape
from namespaces import Namespace, ip

from paper.profiles import Profile

# The addresses that carriers give to phones behind their translation (RFC 6598): 16 for each uplink.
FIRST, BLOCK, SLOTS = IPv4Address("100.64.0.0"), 16, 1 << 18
# Where a process looks first for free places; others may stand there, then it looks on.
SLOTS_A_PROCESS = 8
LINK_PREFIX, CABLE_PREFIX = 29, 30
CABLE = "machine"
# Making one is mostly waiting for the kernel and for the link's process.
AT_ONCE = 4
_numbers = count(1)


@dataclass(frozen=True)
class Addresses:
    """What one uplink has of the machine's addresses, by its place."""

    slot: int

    @property
    def device(self) -> str:
        """The machine's end of the cable; that no two have this name keeps two uplinks from one place."""
        return f"rtup{self.slot}"

    @property
    def peer(self) -> str:
        """The cable's other end, until it is in a namespace."""
        return f"{self.device}p"

    @property
    def inside(self) -> tuple[str, str]:
        """Those that the inside may have at the link, one after the other."""
        return self._at(1), self._at(3)

    @property
    def gateway(self) -> str:
        """The link's other end."""
        return self._at(2)

    @property
    def block(self) -> str:
        """All of them, as a route takes them."""
        return f"{self._at(0)}/28"

    @property
    def cable(self) -> tuple[str, str]:
        """The machine's and the uplink's end of the cable between them."""
        return self._at(9), self._at(10)

    def _at(self, number: int) -> str:
        return str(FIRST + self.slot * BLOCK + number)


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
        self._link: Link | None = None
        self._is_first = True
        self._made = ExitStack()

    def __enter__(self) -> Uplink:
        """Make it."""
        with ExitStack() as made:
            if self.profile.is_plain:
                self._lay_plain(made)
            else:
                self._lay_link(made)
            self._made = made.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Remove it."""
        self._made.close()

    @property
    def server_end(self) -> Namespace:
        """Where the link ends, with the address that the inside reaches first; a plain uplink has no such place."""
        if self._link is None:
            raise RuntimeError("an uplink that emulates nothing ends on this machine itself")
        return self._link.server

    def counts(self) -> tuple[Counts, Counts]:
        """What became of the packets so far, up and down; a plain uplink counts nothing."""
        return (Counts(), Counts()) if self._link is None else self._link.counts()

    def change(self, *, up: Shape | None = None, down: Shape | None = None) -> None:
        """Be another network from now on, with the same addresses; a plain one cannot."""
        if self._link is None:
            raise RuntimeError("cannot change an uplink that emulates nothing: give it a profile")
        self._link.change(up=up, down=down)

    def readdress(self) -> None:
        """Take the inside's address and give it another one, as a new lease may; a plain uplink cannot."""
        if self._link is None:
            raise RuntimeError(
                "cannot readdress an uplink that emulates nothing: it has one address"
            )
        name = self.inside.name
        ip("-n", name, "address", "flush", "dev", LINK_DEVICE)
        self._is_first = not self._is_first
        self.inside = Namespace(name, self._addresses.inside[0 if self._is_first else 1])
        ip("-n", name, "address", "add", f"{self.inside.address}/{LINK_PREFIX}", "dev", LINK_DEVICE)
        # It went with the address.
        ip("-n", name, "route", "add", "default", "via", self._addresses.gateway)

    def _lay_plain(self, made: ExitStack) -> None:
        self._addresses = allot(made)
        name = f"{namespaces.PREFIX}-{os.getpid()}-{next(_numbers)}-plain"
        self.inside = Namespace(name, self._addresses.cable[1])
        made.callback(namespaces.remove, name)
        namespaces.make(self.inside)
        join(self.inside, self._addresses)

    def _lay_link(self, made: ExitStack) -> None:
        self._addresses = allot(made)
        link = Link(
            up=self.profile.up,
            down=self.profile.down,
            seed=next(_numbers),
            robot_address=self._addresses.inside[0],
            server_address=self._addresses.gateway,
            prefix_length=LINK_PREFIX,
        )
        self._link = made.enter_context(link)
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
