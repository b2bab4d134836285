"""The command lines of OpenSSH's client, as pure functions; used by the tunnel.

Only options that every OpenSSH from 8.2 to 10 knows, and no configuration file: what a person
wrote in /etc/ssh or ~/.ssh must not change how the robot connects.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from urllib.parse import urlsplit

from robotether_agent.known_hosts import ALIAS

Kind = Literal["session", "media"]
CONNECT_TIMEOUT_S = 10


@dataclass(frozen=True)
class Target:
    """One SSH address of the server."""

    host: str
    port: int
    user: str

    def __str__(self) -> str:
        return f"{self.host} port {self.port}"


@dataclass(frozen=True)
class SshFiles:
    """The files of one connection; `control` is the socket that takes forwards later."""

    key: Path
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
    """Return the command of a connection whose stdin and stdout carry the session of `kind`."""
    options = {
        "BatchMode": "yes",
        "ConnectTimeout": str(CONNECT_TIMEOUT_S),
        "ControlPersist": "no",
        "ExitOnForwardFailure": "yes",
        "GlobalKnownHostsFile": "/dev/null",
        "HostKeyAlias": ALIAS,
        "IdentitiesOnly": "yes",
        "IdentityAgent": "none",
        "IdentityFile": str(files.key),
        "LogLevel": "INFO",
        "PreferredAuthentications": "publickey",
        "RequestTTY": "no",
        "ServerAliveCountMax": "3",
        "ServerAliveInterval": "5",
        "StrictHostKeyChecking": "yes",
        # The pin is ours to set, so the server must not add keys by itself.
        "UpdateHostKeys": "no",
        "UserKnownHostsFile": str(files.known_hosts),
    }
    flags = [word for name, value in options.items() for word in ("-o", f"{name}={value}")]
    address = f"{target.user}@{target.host}"
    control = ["-M", "-S", str(files.control)]
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
