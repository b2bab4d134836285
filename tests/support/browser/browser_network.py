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
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import namespaces

LAUNCHER = Path(__file__).with_name("chromium_in_namespace")


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
        return {**os.environ, "BROWSER_NAMESPACE": self.name}


@functools.cache
def browser_network() -> BrowserNetwork:
    namespaces.sweep()
    made = ExitStack()
    atexit.register(made.close)
    # This machine has other addresses too, as that at which the demo is asked.
    inside, machine = namespaces.make_joined(made, "browser")
    return BrowserNetwork(inside.name, machine)
