"""OpenSSH's client: its command lines, the connection that it gets from us, and the meaning of its error output.

Only options that every OpenSSH from 8.2 to 10 knows, and no configuration file: what a person wrote in /etc/ssh or
~/.ssh must not change how the robot connects. The texts are those of OpenSSH 8.2 to 10 too; what none of them matches
is shown in ssh's own words.
"""

from __future__ import annotations

import os
import re
import shlex
import socket
import sys
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple
from urllib.parse import urlsplit

from robotether_common.session import Kind

from robotether_agent.describe_error import SILENT_ADVICE
from robotether_agent.enrolment.keys import ALIAS, HOST_KEY_ADVICE
from robotether_agent.fields import printable
from robotether_agent.net.server_dialer import SshAddress
from robotether_agent.problems import (
    AgentError,
    ForwardFailedError,
    KeyRefusedError,
    KeyUnusableError,
    LinkLostError,
    PortTakenError,
    ServerKeyChangedError,
    ServerUnreachableError,
    SessionRefusedError,
    SshIncompatibleError,
)

CONNECT_TIMEOUT_S = 10
# What the network may know of each kind: heartbeats and control go first, a file copy gives way.
# OpenSSH's own choice for a client without a terminal is the lowest class for all of them.
# 8 is "throughput", a name that OpenSSH 10 takes for no class at all.
IP_QOS: dict[Kind, str] = {"session": "af21", "media": "8", "shell": "8"}
# Exit status of ssh's own errors; any other is that of the command on the server.
SSH_FAILED = 255
HELPER = Path(__file__).with_name("fd_passing_helper.py")

HOST_KEY = re.compile(
    r"REMOTE HOST IDENTIFICATION HAS CHANGED|Host key verification failed|host key is known for"
)
SESSION_COMMAND_PREFIX = "robotether: "
SESSION_COMMAND = re.compile(f"^{SESSION_COMMAND_PREFIX}")
KEY_DAMAGED = re.compile(r"Load key .*: (?:invalid format|error in libcrypto)")
KEY_FILE = re.compile(
    r"UNPROTECTED PRIVATE KEY|Load key .*: (?!.*incorrect passphrase)|bad permissions"
)
KEY_REFUSED = re.compile(r"Permission denied \(|Too many authentication failures")
INCOMPATIBLE = re.compile(
    r"Unable to negotiate|no matching .* found|Bad configuration option|unknown option|"
    r"unsupported option|Protocol major versions differ"
)
# After the connection and the first words, as on a path that loses large packets.
FALLS_SILENT = re.compile(r"Connection to .* timed out|timed out during banner exchange")
SILENT = "it begins to answer, and then falls silent"
UNREACHABLE = re.compile(
    r"during banner exchange|kex_exchange_identification|ssh_exchange_identification|banner line|"
    r"Connection (?:closed|reset|timed out)|Broken pipe"
)
PORT_TAKEN = re.compile(r"remote port forwarding failed for listen port|[Pp]ort forwarding failed")


@dataclass(frozen=True)
class SshFiles:
    """The files of one connection.

    `keys` are in the order in which they are shown to the server; the socket `control` accepts forwards later.
    """

    keys: tuple[Path, ...]
    known_hosts: Path
    control: Path


class ServiceAddress(NamedTuple):
    """Where a forward leads: a service on or near the robot."""

    host: str
    port: int


def target_of(url: str) -> ServiceAddress:
    """Return where the service at `url`, which names its port, listens."""
    split = urlsplit(url)
    if split.hostname is None or split.port is None:
        raise ValueError(f"{url} has no host and port")
    return ServiceAddress(split.hostname, split.port)


@dataclass(frozen=True)
class Forward:
    """A remote forward: a port on the server that leads to a target."""

    listen_port: int
    host: str
    port: int

    @property
    def spec(self) -> str:
        """As ssh -R takes it."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"0.0.0.0:{self.listen_port}:{host}:{self.port}"


def connect_command(target: SshAddress, files: SshFiles, kind: Kind) -> list[str]:
    """Return the command of a connection whose stdin and stdout carry the session of `kind`.

    It finds its TCP connection in its stderr (`stderr_with`).
    """
    options = [
        *_trust_options(files.known_hosts),
        *_proxy_options(),
        "ControlPersist=no",
        "ExitOnForwardFailure=yes",
        *(f"IdentityFile={key}" for key in files.keys),
        f"IPQoS={IP_QOS[kind]}",
        "PreferredAuthentications=publickey",
        "ServerAliveCountMax=3",
        "ServerAliveInterval=5",
    ]
    return _command(target, options, ["-M", "-S", str(files.control)], kind)


def host_key_command(target: SshAddress, known_hosts: Path) -> list[str]:
    """Return the command that checks the server's host key, and gets no further than that.

    It, too, finds its TCP connection in its stderr.
    """
    options = [*_trust_options(known_hosts), "IdentityFile=none", "PreferredAuthentications=none"]
    options += _proxy_options()
    return _command(target, options, ["-S", "none"], "session")


def _proxy_options() -> list[str]:
    """Return the options with which OpenSSH's client takes its connection from fd_passing_helper."""
    # -I -S: nothing from this user's or this machine's Python comes in between, and it starts in half the time.
    words = [sys.executable, "-I", "-S", str(HELPER)]
    # OpenSSH expands % in the command, and gives it to a shell.
    command = " ".join(map(shlex.quote, words)).replace("%", "%%")
    return [f"ProxyCommand={command}", "ProxyUseFdpass=yes"]


def stderr_with(connection: socket.socket) -> tuple[socket.socket, socket.socket]:
    """Return our end and the client's end of a stderr in which `connection` waits for fd_passing_helper.

    The client would otherwise make its own connection. The stderr is a Unix socket, in which fd_passing_helper, which
    the client runs as its ProxyCommand, finds it: no name in a file system and no other program is needed.
    """
    ours, clients = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        descriptor = array("i", [connection.fileno()])
        ours.sendmsg([b"\0"], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, descriptor)])
        ours.setblocking(False)
    except OSError:
        ours.close()
        clients.close()
        raise
    return ours, clients


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


def _command(target: SshAddress, options: list[str], control: list[str], kind: Kind) -> list[str]:
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


def why_not_connected(
    stderr: Sequence[str], status: int, target: SshAddress, files: SshFiles
) -> AgentError:
    """Return why a client ended before the server sent a configuration."""
    for pattern, kind, why, advice in _BEFORE_CONFIG:
        line = _first(stderr, pattern)
        if line is not None:
            words = {"target": target, "line": line.removeprefix(SESSION_COMMAND_PREFIX)}
            words |= {"key": files.keys[0] if files.keys else "", "known_hosts": files.known_hosts}
            return kind(why.format(**words), advice=advice and advice.format(**words))
    last_line = _last(stderr)
    if status != SSH_FAILED:
        why = last_line or f"status {status}, and no message"
        return SessionRefusedError(
            f"cannot open the session at {target}: the server's command ended: {why}"
        )
    return LinkLostError(f"cannot connect to {target}: {last_line or 'ssh ended silently'}")


def why_ended(stderr: Sequence[str], status: int | None, target: SshAddress) -> AgentError:
    """Return why a client ended that had been connected; `stderr` is what it printed since then."""
    return LinkLostError(f"lost the connection to {target}: {_last(stderr) or _silent_end(status)}")


def _silent_end(status: int | None) -> str:
    if status is None or status < 0:
        return "ssh was killed"
    if status == SSH_FAILED:
        return "ssh ended and gave no reason"
    return f"the server ended the session (status {status})"


def why_no_forward(stderr: Sequence[str], forward: Forward, action: str) -> AgentError:
    """Return why the running client did not add or cancel `forward`."""
    if _first(stderr, PORT_TAKEN) is not None:
        return PortTakenError(
            f"cannot open port {forward.listen_port} on the server: it refuses the port to this robot",
            advice="another connection still holds it, or the robot's ports have changed; this is tried again",
        )
    last_line = _last(stderr) or "without a word"
    return ForwardFailedError(f"cannot {action} the forward {forward.spec}: {last_line}")


# The order counts: a refused host key or key file also ends in lines that later patterns match.
_BEFORE_CONFIG: tuple[tuple[re.Pattern[str], type[AgentError], str, str | None], ...] = (
    (SESSION_COMMAND, SessionRefusedError, "cannot open the session at {target}: {line}", None),
    (
        HOST_KEY,
        ServerKeyChangedError,
        "cannot trust {target}: its host key is not one of those pinned at the first join ({line})",
        HOST_KEY_ADVICE,
    ),
    (
        KEY_DAMAGED,
        KeyUnusableError,
        "cannot use this robot's key: {line}",
        "this file is damaged: remove it and the one with .pub; a robot without a key joins with a new one",
    ),
    (
        KEY_FILE,
        KeyUnusableError,
        "cannot use the key {key}: {line}",
        "let only the agent's user read it: chmod 600 {key}",
    ),
    (
        KEY_REFUSED,
        KeyRefusedError,
        "cannot log in at {target}: the server refuses this robot's key ({line})",
        None,
    ),
    (INCOMPATIBLE, SshIncompatibleError, "cannot talk to {target}: {line}", None),
    (
        FALLS_SILENT,
        ServerUnreachableError,
        f"cannot reach SSH at {{target}}: {SILENT}",
        SILENT_ADVICE,
    ),
    (
        UNREACHABLE,
        ServerUnreachableError,
        "cannot reach SSH at {target}: {line}",
        SILENT_ADVICE,
    ),
)


def _first(stderr: Sequence[str], pattern: re.Pattern[str]) -> str | None:
    line = next((line for line in stderr if pattern.search(line)), None)
    return None if line is None else printable(line.strip("@ \t\r"), 200)


def _last(stderr: Sequence[str]) -> str:
    lines = [line for line in stderr if line.strip()]
    return printable(lines[-1], 200) if lines else ""
