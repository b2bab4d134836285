"""Network namespaces for tests: made under names that say whose they are, entered, joined to this machine, and removed.

Needs root. A name is `rtlink-PID-NUMBER-END`; whoever makes one first sweeps away those whose process is gone.
"""

from __future__ import annotations

import ctypes
import os
import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from ipaddress import IPv4Address
from itertools import chain, count
from pathlib import Path

from commands import output_of_command, run_command

PREFIX = "rtlink"
PLACE = Path("/run/netns")
OWN_NAME = re.compile(rf"{PREFIX}-(\d+)-\d+-\w+")
CLONE_NEWNET = 0x40000000
# The addresses that carriers give to phones behind their translation (RFC 6598): four for each cable to this machine.
FIRST, PLACES = IPv4Address("100.64.0.0"), 1 << 20
# Where a process looks first for free places; others may stand there, then it looks on.
PLACES_A_PROCESS = 8
CABLE = "machine"
_numbers = count(1)
_libc = ctypes.CDLL(None, use_errno=True)


@dataclass(frozen=True)
class Namespace:
    """One end of a link: a network of its own with `address` on it."""

    name: str
    address: str

    @property
    def path(self) -> Path:
        return PLACE / self.name

    def command(self, *words: str) -> list[str]:
        return ["nsenter", f"--net={self.path}", "--", *words]

    def run(self, *words: str) -> str:
        return output_of_command(*self.command(*words))

    def sysctl(self, name: str, value: str) -> None:
        self.run("sysctl", "-qw", f"{name}={value}")

    @contextmanager
    def entered(self) -> Iterator[None]:
        """Let this thread, and what it starts meanwhile, be inside; a socket stays where it was made."""
        before = os.open("/proc/thread-self/ns/net", os.O_RDONLY)
        try:
            enter(self.name)
            yield
        finally:
            _set_namespace(before)
            os.close(before)


def enter(name: str) -> None:
    descriptor = os.open(PLACE / name, os.O_RDONLY)
    try:
        _set_namespace(descriptor)
    finally:
        os.close(descriptor)


def make(made: ExitStack, end: str, address: str = "") -> Namespace:
    namespace = Namespace(f"{PREFIX}-{os.getpid()}-{next(_numbers)}-{end}", address)
    made.callback(remove, namespace.name)
    ip("netns", "add", namespace.name)
    ip("-n", namespace.name, "link", "set", "lo", "up")
    return namespace


def make_joined(made: ExitStack, end: str) -> tuple[Namespace, str]:
    """Make one whose only way out is a cable to this machine; also this machine's address at the cable."""
    inside = make(made, end)
    # Also for the cable to come, which would else get a second address a moment after it is up.
    for which in ("all", "default"):
        inside.sysctl(f"net.ipv6.conf.{which}.disable_ipv6", "1")
    place = _lay_cable(made, inside)
    device, here, there = f"rtup{place}", *(str(FIRST + 4 * place + side) for side in (1, 2))
    ip("address", "add", f"{here}/30", "dev", device)
    ip("link", "set", device, "up")
    ip("-n", inside.name, "address", "add", f"{there}/30", "dev", CABLE)
    ip("-n", inside.name, "link", "set", CABLE, "up")
    ip("-n", inside.name, "route", "add", "default", "via", here)
    return inside, here


def _lay_cable(made: ExitStack, inside: Namespace) -> int:
    """Take a free place by making its cable: the kernel gives each name once."""
    first = os.getpid() * PLACES_A_PROCESS % PLACES
    for place in chain(range(first, PLACES), range(first)):
        ends = (f"rtup{place}", "type", "veth", "peer", "name", CABLE, "netns", inside.name)
        done = run_command("ip", "link", "add", *ends)
        if done.returncode == 0:
            # It may have gone with the namespace.
            made.callback(run_command, "ip", "link", "delete", f"rtup{place}")
            return place
        if "File exists" not in done.stderr:
            raise RuntimeError(f"cannot lay a cable to {inside.name}: {done.stderr.strip()}")
    raise RuntimeError(f"cannot lay a cable to {inside.name}: all {PLACES} places are taken")


def remove(name: str) -> None:
    """Remove it, if it is there; it lives on, without a name, while a process is inside."""
    if (PLACE / name).exists():
        ip("netns", "delete", name)


def sweep() -> None:
    for path in PLACE.glob(f"{PREFIX}-*"):
        match = OWN_NAME.fullmatch(path.name)
        if match and not Path("/proc", match[1]).exists():
            # Two sweepers may find the same one.
            run_command("ip", "netns", "delete", path.name)


def ip(*words: str) -> None:
    output_of_command("ip", *words)


def _set_namespace(descriptor: int) -> None:
    # os.setns is there from Python 3.12 on.
    if _libc.setns(descriptor, CLONE_NEWNET) != 0:
        code = ctypes.get_errno()
        raise OSError(code, f"cannot enter a network namespace: {os.strerror(code)}")
