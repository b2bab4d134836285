"""Network namespaces for tests: made under names that say whose they are, entered, and removed.

Needs root. A name is `rtlink-PID-NUMBER-END`; whoever makes one first sweeps away those whose process is gone.
"""

from __future__ import annotations

import ctypes
import os
import re
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

PREFIX = "rtlink"
PLACE = Path("/run/netns")
OWN_NAME = re.compile(rf"{PREFIX}-(\d+)-\d+-\w+")
CLONE_NEWNET = 0x40000000
_libc = ctypes.CDLL(None, use_errno=True)


@dataclass(frozen=True)
class Namespace:
    """One end of a link: a network of its own with `address` on it."""

    name: str
    address: str

    @property
    def path(self) -> Path:
        """The file that stands for it."""
        return PLACE / self.name

    def command(self, *words: str) -> list[str]:
        """Return the command that runs `words` inside."""
        return ["nsenter", f"--net={self.path}", "--", *words]

    def run(self, *words: str) -> str:
        """Run a short command inside and return what it printed."""
        done = subprocess.run(self.command(*words), capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise RuntimeError(f"cannot run {' '.join(words)} in {self.name}: {done.stderr}")
        return done.stdout

    def sysctl(self, name: str, value: str) -> None:
        """Set a kernel setting that each network has for itself."""
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
    """Move this thread into the namespace `name`."""
    descriptor = os.open(PLACE / name, os.O_RDONLY)
    try:
        _set_namespace(descriptor)
    finally:
        os.close(descriptor)


def make(namespace: Namespace) -> None:
    """Make it, with its loopback up."""
    ip("netns", "add", namespace.name)
    ip("-n", namespace.name, "link", "set", "lo", "up")


def remove(name: str) -> None:
    """Remove it, if it is there; it lives on, without a name, while a process is inside."""
    if (PLACE / name).exists():
        ip("netns", "delete", name)


def sweep() -> None:
    """Remove the namespaces of processes that are gone."""
    for path in PLACE.glob(f"{PREFIX}-*"):
        match = OWN_NAME.fullmatch(path.name)
        if match and not Path("/proc", match[1]).exists():
            # Two sweepers may find the same one.
            subprocess.run(["ip", "netns", "delete", path.name], capture_output=True, check=False)


def ip(*words: str) -> None:
    """Run iproute2."""
    done = subprocess.run(["ip", *words], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"cannot run ip {' '.join(words)}: {done.stderr.strip()}")


def _set_namespace(descriptor: int) -> None:
    # os.setns is there from Python 3.12 on.
    if _libc.setns(descriptor, CLONE_NEWNET) != 0:
        code = ctypes.get_errno()
        raise OSError(code, f"cannot enter a network namespace: {os.strerror(code)}")
