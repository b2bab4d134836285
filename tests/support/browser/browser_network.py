"""A network of its own for the tests' browser, so that no other test's containers disturb it.

Chromium drops every request that is under way when an interface of its network comes or goes, and the Docker engine
adds and removes some for each container. In its own namespace there is one interface, and it stays. Needs root; made
once a process, and removed at its end. A server that a test's page is to reach must listen on 0.0.0.0, not on
127.0.0.1 alone.
"""

from __future__ import annotations

import atexit
import functools
import os
from dataclasses import dataclass
from pathlib import Path

import namespaces
from namespaces import Namespace, ip

LAUNCHER = Path(__file__).with_name("chromium_in_namespace")
# Of 10.203.0.0/16 each process has four addresses by its id: of so many processes few run at a time.
NETWORK, PLACES = "10.203", 1 << 14
DEVICE = "machine"


@dataclass(frozen=True)
class BrowserNetwork:
    """The namespace, and this machine's address as seen from there."""

    name: str
    machine: str

    @property
    def arguments(self) -> list[str]:
        """What Chromium is told, so that pages of this machine have the names that they have outside."""
        rules = ", ".join(f"MAP {name} {self.machine}" for name in ("localhost", "127.0.0.1"))
        return [f"--host-resolver-rules={rules}"]

    @property
    def environment(self) -> dict[str, str | float | bool]:
        """What the launcher is told."""
        return {**os.environ, "BROWSER_NAMESPACE": self.name}


@functools.cache
def browser_network() -> BrowserNetwork:
    """Return this process's network for browsers."""
    namespaces.sweep()
    pid = os.getpid()
    first = pid % PLACES * 4
    machine, browser = (f"{NETWORK}.{first >> 8}.{(first & 255) + place}" for place in (1, 2))
    inside, outside = Namespace(f"{namespaces.PREFIX}-{pid}-0-browser", browser), f"rtweb{pid}"
    namespaces.make(inside)
    # Else the interface gets a second address a moment after it is up, which is such a change again.
    inside.sysctl("net.ipv6.conf.all.disable_ipv6", "1")
    inside.sysctl("net.ipv6.conf.default.disable_ipv6", "1")
    atexit.register(namespaces.remove, inside.name)
    # With the namespace goes its end of the pair, and with that the other end.
    ip("link", "add", outside, "type", "veth", "peer", "name", DEVICE, "netns", inside.name)
    ip("address", "add", f"{machine}/30", "dev", outside)
    ip("link", "set", outside, "up")
    ip("-n", inside.name, "address", "add", f"{browser}/30", "dev", DEVICE)
    ip("-n", inside.name, "link", "set", DEVICE, "up")
    # This machine has other addresses too, as that at which the demo is asked.
    ip("-n", inside.name, "route", "add", "default", "via", machine)
    return BrowserNetwork(inside.name, machine)
