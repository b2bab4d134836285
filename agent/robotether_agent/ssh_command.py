"""The command lines of OpenSSH's client, as pure functions; used by the tunnel.

Only options that every OpenSSH from 8.2 to 10 knows, and no configuration file: what a person
wrote in /etc/ssh or ~/.ssh must not change how the robot connects.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Protocol
from urllib.parse import urlsplit

from robotether_agent.dialing.handover import proxy_options
from robotether_agent.known_hosts import ALIAS

Kind = Literal["session", "media", "shell"]
CONNECT_TIMEOUT_S = 10
# What the network may know of each kind: heartbeats and control go first, a file copy gives way.
# OpenSSH's own choice for a client without a terminal is the lowest class for all of them.
# 8 is "throughput", a name that OpenSSH 10 takes for no class at all.
IP_QOS: dict[Kind, str] = {"session": "af21", "media": "8", "shell": "8"}


class WayThere(Protocol):
    """What makes the TCP connections that the client is given (robotether_agent.dialing.way)."""

    @property
    def is_proxied(self) -> bool:
        """Whether the other end of a connection is not the server's."""

    async def find(self, targets: Sequence[Target], /) -> Target:
        """Return which of the targets answers."""

    async def open(self, target: Target, /) -> socket.socket:
        """Return a connection to `target`."""


@dataclass(frozen=True)
class Target:
    """One SSH address of the server, and who knows the way to it; without, it is gone straight."""

    host: str
    port: int
    user: str
    way: WayThere | None = field(default=None, compare=False, repr=False)

    def __str__(self) -> str:
        return f"{self.host} port {self.port}"


@dataclass(frozen=True)
class SshFiles:
    """The files of one connection.

    `keys` stand in the order in which they are shown to the server; the socket `control` takes forwards later.
    """

    keys: tuple[Path, ...]
    known_hosts: Path
    control: Path


@dataclass(frozen=True)
class Forward:
    """A remote forward: a port on the server that leads to a service on or near the robot."""

    listen_port: int
    host: str
    port: int

    @property
    def spec(self) -> str:
        """As ssh -R takes it."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"0.0.0.0:{self.listen_port}:{host}:{self.port}"


def forward_to(url: str, listen_port: int) -> Forward:
    """Return the forward of `listen_port` to the service at `url`, which names its port."""
    split = urlsplit(url)
    if split.hostname is None or split.port is None:
        raise ValueError(f"{url} has no host and port")
    return Forward(listen_port, split.hostname, split.port)


def connect_command(target: Target, files: SshFiles, kind: Kind) -> list[str]:
    """Return the command of a connection whose stdin and stdout carry the session of `kind`.

    It finds its TCP connection in its stderr (robotether_agent.dialing.handover).
    """
    options = [
        *_trust_options(files.known_hosts),
        *proxy_options(),
        "ControlPersist=no",
        "ExitOnForwardFailure=yes",
        *(f"IdentityFile={key}" for key in files.keys),
        f"IPQoS={IP_QOS[kind]}",
        "PreferredAuthentications=publickey",
        "ServerAliveCountMax=3",
        "ServerAliveInterval=5",
    ]
    return _command(target, options, ["-M", "-S", str(files.control)], kind)


def host_key_command(target: Target, known_hosts: Path) -> list[str]:
    """Return the command that checks the server's host key, and gets no further than that.

    It, too, finds its TCP connection in its stderr.
    """
    options = [*_trust_options(known_hosts), "IdentityFile=none", "PreferredAuthentications=none"]
    options += proxy_options()
    return _command(target, options, ["-S", "none"], "session")


def _trust_options(known_hosts: Path) -> list[str]:
    return [
        "BatchMode=yes",
        f"ConnectTimeout={CONNECT_TIMEOUT_S}",
        "GlobalKnownHostsFile=/dev/null",
        f"HostKeyAlias={ALIAS}",
        "IdentitiesOnly=yes",
        "IdentityAgent=none",
        "LogLevel=INFO",
        "RequestTTY=no",
        "StrictHostKeyChecking=yes",
        # The pin is ours to set, so the server must not add keys by itself.
        "UpdateHostKeys=no",
        f"UserKnownHostsFile={known_hosts}",
    ]


def _command(target: Target, options: list[str], control: list[str], kind: Kind) -> list[str]:
    flags = [word for option in options for word in ("-o", option)]
    address = f"{target.user}@{target.host}"
    return ["ssh", "-F", "none", *control, *flags, "-p", str(target.port), "--", address, kind]


def control_command(
    control: Path, action: Literal["forward", "cancel", "exit"], forward: Forward | None = None
) -> list[str]:
    """Return the command that asks the running client behind `control` to do `action`."""
    what = [] if forward is None else ["-R", forward.spec]
    return ["ssh", "-F", "none", "-S", str(control), "-O", action, *what, "--", ALIAS]


def child_environment() -> dict[str, str]:
    """Return the environment of the client: nothing in it that could change what it does or says."""
    return {"PATH": os.environ.get("PATH", os.defpath), "LC_ALL": "C"}
