"""Networks of robots and operators: namespaces whose only way out is a cable to this machine.

    with uplinks(2, "172.17.0.1") as (one, other):
        one.inside.run("ip", "route", "get", one.machine)

Packets are routed and never translated, so that the server sees the address that the robot has; published ports are
reached by the kernel's own translation, as from outside, and not by a proxy process. Needs root; adds nothing to the
machine's firewall. IPv4 alone.
"""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

import namespaces
from namespaces import Namespace


@dataclass(frozen=True)
class Uplink:
    """One network."""

    inside: Namespace
    # An address of this machine that is reached from inside.
    machine: str


@contextmanager
def uplinks(how_many: int, machine: str) -> Iterator[list[Uplink]]:
    """Make so many, and remove them all; `machine` is this machine's address for them."""
    namespaces.sweep()
    with ExitStack() as made:
        yield [Uplink(namespaces.make_joined(made, "uplink")[0], machine) for _ in range(how_many)]


def made_in(namespace: Namespace) -> dict[str, Any]:
    """What has a TCPConnector make its sockets inside a namespace, where they stay; names are looked up outside."""

    def make(address: Any) -> socket.socket:
        family, kind, protocol, *_ = address
        with namespace.entered():
            return socket.socket(family, kind, protocol)

    return {"socket_factory": make}
