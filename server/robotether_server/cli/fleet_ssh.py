"""Finds robots in OpenSSH's configuration and connects to them, over one connection to each jump host.

What OpenSSH itself would do is asked with `ssh -G` and `ssh-keygen -F`: so `Include`, `Match`, defaults, the order of
files and the patterns of known_hosts are its own, and what works with `ssh NAME` works here. The person's keys come in
OpenSSH's order (the agent's that the configuration names, its others, files), because a server hangs up after a few
keys that it does not know. Every connection, a jump host's too, passes HostKeyCheck: an unknown key may be taken on a
person's word (`--accept-new`), a changed or revoked one never. Must never use fabric's own gateways, which trust any
key, nor send anything to a host whose key it has not checked, or to one that is no robot.
"""

import base64
import glob
import logging
import os
import re
import shlex
import socket
import subprocess
from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase
from getpass import getuser
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple

import fabric
import paramiko
from cryptography.exceptions import UnsupportedAlgorithm
from paramiko.auth_strategy import AuthStrategy, InMemoryPrivateKey

from robotether_server.problems import RobotetherError, reason_in

USER_CONFIG = Path("~/.ssh/config")
ALIAS = "robotether-"
# Maximum depth of Include, as in OpenSSH.
MAX_INCLUDE_DEPTH = 16
SSH_PORT = 22
CONNECT_TIMEOUT_S = 10.0
ANSWER_WITHIN_S = 10
LOGIN_TIMEOUT_S = 30
KEEPALIVE_S = 10
# OpenSSH's word for the agent that the environment names.
USUAL_AGENT = "SSH_AUTH_SOCK"
BETWEEN_PATHS = re.compile(r"\s+(?=[/~]|none$)")
# Exit status of ssh-keygen for a name that is in no line.
NOT_FOUND = 1
# Reason code for a prohibited channel (RFC 4254, 5.1).
PROHIBITED = 1
CONNECT_FAILED = 2
# By the type of key that known_hosts has: what the server may prove it with.
ALGORITHMS = {
    "ssh-ed25519": ("ssh-ed25519",),
    "ecdsa-sha2-nistp256": ("ecdsa-sha2-nistp256",),
    "ecdsa-sha2-nistp384": ("ecdsa-sha2-nistp384",),
    "ecdsa-sha2-nistp521": ("ecdsa-sha2-nistp521",),
    "ssh-rsa": ("rsa-sha2-512", "rsa-sha2-256"),
}
WEAK = ("ssh-rsa", "ssh-dss")

log = logging.getLogger(__name__)


class FleetError(RobotetherError):
    """Why a command does not reach a robot, for the person who sent it."""


@dataclass(frozen=True)
class Target:
    """One host to log in to. `known_as`: its name in the known_hosts files; `jump`: through which host."""

    name: str
    host: str
    port: int
    user: str
    known_as: str
    known_hosts: tuple[Path, ...]
    identity_files: tuple[Path, ...]
    identities_only: bool
    connect_timeout_s: float
    jump: "Target | None" = None
    identity_agent: str = USUAL_AGENT


def choose(config: Path | None, patterns: Iterable[str]) -> list[str]:
    """Return the robots that a pattern names, by name; raise FleetError for a pattern without any."""
    path = (config or USER_CONFIG).expanduser()
    robots = sorted(robots_in(path))
    chosen: set[str] = set()
    for pattern in patterns:
        hits = [name for name in robots if fnmatchcase(name, pattern)]
        if not hits:
            names = ", ".join(robots) or "no robot at all"
            raise FleetError(
                f"cannot find robots for {pattern}: {path} has {names}; update it with: robotether ssh-config"
            )
        chosen.update(hits)
    return sorted(chosen)


def robots_in(path: Path) -> set[str]:
    """Return the names of all robots of a configuration and of what it includes."""
    names: list[str] = []
    robots: set[str] = set()
    for keyword, arguments in directives(path):
        if keyword in ("host", "match"):
            # A pattern names no robot.
            names = [name for name in arguments if keyword == "host" and not set(name) & set("*?!")]
        elif keyword == "hostkeyalias" and arguments and arguments[0].startswith(ALIAS):
            robots.update(names)
    return robots


def directives(path: Path, depth: int = 0) -> Iterator[tuple[str, list[str]]]:
    """Yield each keyword in lower case with its arguments; an included file is read at its Include."""
    if depth > MAX_INCLUDE_DEPTH:
        raise FleetError(f"cannot read {path}: it is included over {MAX_INCLUDE_DEPTH} deep")
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise FleetError(
            f"cannot read {path}: {reason_in(error)}; write it with: robotether ssh-config, or name another with "
            "--ssh-config"
        ) from error
    for line in text.splitlines():
        keyword, arguments = words(line)
        if keyword == "include":
            for included in (part for pattern in arguments for part in matches(pattern)):
                yield from directives(included, depth + 1)
        elif keyword:
            yield keyword, arguments


def words(line: str) -> tuple[str, list[str]]:
    """Split `Keyword argument "another one"` or `Keyword=argument`; an empty line gives an empty keyword."""
    try:
        parts = shlex.split(line, comments=True)
    except ValueError:
        return "", []
    if not parts:
        return "", []
    keyword, equals, rest = parts[0].partition("=")
    return keyword.lower(), [rest, *parts[1:]] if equals and rest else parts[1:]


def matches(pattern: str) -> list[Path]:
    """Return the files that an `Include` means; names without a folder are below ~/.ssh."""
    full = Path("~/.ssh").expanduser() / Path(pattern).expanduser()
    return [Path(name) for name in sorted(glob.glob(str(full)))]  # noqa: PTH207 - the pattern may be absolute


def resolve(name: str, config: Path | None) -> Target:
    """Return how to reach a robot; raise FleetError."""
    options = ask(name, config)
    jump = None
    for hop in options.get("proxyjump", ["none"])[0].split(","):
        if hop != "none":
            jump = _target(f"the jump host {hop}", ask(f"ssh://{hop}", config), jump)
    return _target(name, options, jump)


def ask(destination: str, config: Path | None) -> dict[str, list[str]]:
    """Return OpenSSH's settings for a destination: each keyword's values, one a line of `ssh -G`."""
    chosen = [] if config is None else ["-F", str(config)]
    # -T: it only prints, and must neither ask nor speak of terminals.
    done = _openssh("ssh", *chosen, "-T", "-G", "--", destination)
    if done.returncode != 0:
        raise FleetError(f"cannot reach {destination}: ssh says: {done.stderr.strip()}")
    options: dict[str, list[str]] = defaultdict(list)
    for line in done.stdout.splitlines():
        keyword, _, value = line.partition(" ")
        options[keyword].append(value)
    return dict(options)


def _openssh(*command: str) -> subprocess.CompletedProcess[str]:
    """Run one of OpenSSH's programs, without standard input."""
    try:
        return subprocess.run(  # noqa: S603 - no shell, and names are values of options or come after `--`
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=ANSWER_WITHIN_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        why = reason_in(error)
        raise FleetError(f"cannot ask {command[0]}: {why}; install OpenSSH's client") from error


def _target(name: str, options: dict[str, list[str]], jump: Target | None) -> Target:
    def first(keyword: str, otherwise: str = "") -> str:
        return options.get(keyword, [otherwise])[0]

    if first("proxycommand", "none") != "none":
        raise FleetError(
            f"cannot reach {name}: its entry has a ProxyCommand; fleet supports ProxyJump only"
        )
    host, port = first("hostname"), int(first("port", str(SSH_PORT)))
    user, timeout = first("user"), first("connecttimeout", "none")
    files = [_expand(file, host, user) for file in options.get("identityfile", [])]
    return Target(
        name=name,
        host=host,
        port=port,
        user=user,
        known_as=first("hostkeyalias") or _address(host, port),
        known_hosts=_paths(first("userknownhostsfile"), first("globalknownhostsfile")),
        identity_files=_paths(*files),
        identities_only=first("identitiesonly") == "yes",
        connect_timeout_s=CONNECT_TIMEOUT_S if timeout == "none" else float(timeout),
        jump=jump,
        identity_agent=first("identityagent", USUAL_AGENT),
    )


def _expand(file: str, host: str, user: str) -> str:
    """Put values in place of the usual tokens of an IdentityFile, which `ssh -G` prints as they are."""
    values = {"%": "%", "d": str(Path.home()), "h": host, "r": user, "u": getuser()}
    return re.sub("%(.)", lambda token: values.get(token[1], token[0]), os.path.expandvars(file))


def _address(host: str, port: int) -> str:
    """Return a host's name as known_hosts files have it."""
    return host.lower() if port == SSH_PORT else f"[{host.lower()}]:{port}"


def _paths(*values: str) -> tuple[Path, ...]:
    """Return the files of some values; `ssh -G` quotes no spaces in their paths, which are absolute."""
    names = [name for value in values for name in BETWEEN_PATHS.split(value)]
    return tuple(Path(name).expanduser() for name in names if name not in ("none", "/dev/null", ""))


class KnownKey(NamedTuple):
    """A host's public key: `ssh-ed25519` and its base64."""

    type: str
    encoded: str


def find_known(files: Iterable[Path], name: str) -> tuple[set[KnownKey], set[KnownKey]]:
    """Return the keys that files have for a name, and those that they revoke; a missing file has none."""
    trusted, revoked = set[KnownKey](), set[KnownKey]()
    for line in (line for path in files for line in _known_lines(path, name)):
        match line.split():
            case ["@revoked", _, kind, encoded, *_]:
                revoked.add(KnownKey(kind, encoded))
            # A @cert-authority's line is neither: certificates are not looked at here.
            case [hosts, kind, encoded, *_] if not hosts.startswith(("@", "#")):
                trusted.add(KnownKey(kind, encoded))
    return trusted, revoked


def _known_lines(path: Path, name: str) -> list[str]:
    if not path.exists():
        return []
    done = _openssh("ssh-keygen", "-F", name, "-f", str(path))
    if done.returncode not in (0, NOT_FOUND):
        raise FleetError(f"cannot read the known host keys in {path}: {done.stderr.strip()}")
    return done.stdout.splitlines()


def add_known(path: Path, name: str, key: KnownKey) -> None:
    """Add a key to a file, which is made when it is missing."""
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        path.touch(mode=0o600)
        whole = path.read_bytes()
        broken = bool(whole) and not whole.endswith(b"\n")
        with path.open("a", encoding="utf-8") as file:
            file.write("\n" * broken + f"{name} {key.type} {key.encoded}\n")
    except OSError as error:
        raise FleetError(f"cannot save the key of {name} in {path}: {reason_in(error)}") from error


_writing = Lock()


class HostKeyCheck(paramiko.MissingHostKeyPolicy):  # type: ignore[misc] # paramiko has no types
    """The check of one host."""

    def __init__(self, target: Target, *, accept_new: bool) -> None:
        self._target = target
        self._accept_new = accept_new
        self._trusted, self._revoked = find_known(target.known_hosts, target.known_as)

    def unwanted_algorithms(self) -> list[str]:
        """Return the algorithms that the host must not use: of several keys it has to show the known one."""
        types = {key.type for key in self._trusted} & set(ALGORITHMS)
        usable_types = types or set(ALGORITHMS)
        unwanted = [
            name for kind in ALGORITHMS if kind not in usable_types for name in ALGORITHMS[kind]
        ]
        return [*WEAK, *unwanted]

    def missing_host_key(self, _client: Any, _hostname: str, key: Any) -> None:
        """Accept the host key, or raise FleetError."""
        host_key = KnownKey(key.get_name(), base64.b64encode(key.asbytes()).decode())
        target = self._target
        if host_key in self._revoked:
            raise FleetError(f"cannot trust {target.name}: its host key is marked as revoked")
        if host_key in self._trusted:
            return
        if self._trusted:
            raise changed(target)
        if not self._accept_new:
            raise FleetError(
                f"cannot trust {target.name}: its host key {key.fingerprint} is not known as "
                f"{target.known_as}; compare it at a first `ssh`, or accept it with --accept-new"
            )
        if not target.known_hosts:
            raise FleetError(f"cannot save the key of {target.name}: no UserKnownHostsFile")
        with _writing:
            add_known(target.known_hosts[0], target.known_as, host_key)


def changed(target: Target) -> FleetError:
    """Return the sentence for a host with another key than it had."""
    return FleetError(
        f"cannot trust {target.name}: it shows another host key than the one known as "
        f"{target.known_as}; if it was installed again, forget the old one: "
        f"ssh-keygen -R '{target.known_as}'; if not, somebody may be intercepting the connection"
    )


class NamedAgent(paramiko.Agent):  # type: ignore[misc] # paramiko has no types
    """The agent at a socket of the configuration, such as a password manager's; without one it has no keys."""

    def __init__(self, path: str) -> None:
        paramiko.agent.AgentSSH.__init__(self)
        connection = socket.socket(socket.AF_UNIX)
        try:
            connection.connect(os.path.expandvars(path))
            self._connect(connection)
        except (OSError, paramiko.SSHException):
            connection.close()


class Identities(AuthStrategy):  # type: ignore[misc] # paramiko has no types
    """What one login tries. `locked`: files that need a passphrase."""

    def __init__(self, target: Target) -> None:
        super().__init__(ssh_config=None)
        self._target = target
        self.tried = 0
        self.locked: list[Path] = []
        # An agent's connection carries one request at a time, so each login has its own.
        is_usual = target.identity_agent == USUAL_AGENT
        self._agent = paramiko.Agent() if is_usual else NamedAgent(target.identity_agent)

    def get_sources(self) -> Iterator[Any]:
        """Yield each key once."""
        held = list(self._agent.get_keys())
        named = {blob for path in self._target.identity_files for blob in _public_half(path)}
        chosen = [key for key in held if key.asbytes() in named]
        others = [] if self._target.identities_only else [key for key in held if key not in chosen]
        seen: set[bytes] = set()
        for key in (*chosen, *others, *self._from_files()):
            if key.asbytes() not in seen:
                seen.add(key.asbytes())
                self.tried += 1
                yield InMemoryPrivateKey(self._target.user, key)

    def close(self) -> None:
        """Leave ssh-agent."""
        self._agent.close()

    def _from_files(self) -> Iterator[Any]:
        for path in filter(Path.is_file, self._target.identity_files):
            if (key := self._from_file(path)) is not None:
                yield key

    def _from_file(self, path: Path) -> Any | None:
        try:
            return paramiko.PKey.from_path(path)
        except TypeError:  # cryptography's word for a key with a passphrase
            self.locked.append(path)
        except (OSError, ValueError, UnsupportedAlgorithm, paramiko.SSHException) as error:
            log.warning("cannot use key %s: %s", path, error)
        return None


def _public_half(path: Path) -> Iterator[bytes]:
    """Yield the public key beside a private one, by which ssh-agent knows it."""
    try:
        line = Path(f"{path}.pub").read_text(encoding="utf-8")
        yield paramiko.PublicBlob.from_string(line).key_blob
    except (OSError, ValueError):
        return


@dataclass
class Jump:
    """One jump host: opened by the first robot that needs it, while the others wait."""

    lock: Lock
    connection: fabric.Connection | None = None
    problem: FleetError | None = None


class SshConnections:
    """All connections of one run. Safe to use from many threads."""

    def __init__(self, *, accept_new: bool) -> None:
        self._accept_new = accept_new
        self._lock = Lock()
        self._jumps: dict[Target, Jump] = {}
        self._open: list[fabric.Connection] = []
        self._closed = False

    def open(self, target: Target) -> fabric.Connection:
        """Return a connection that is logged in; raise a FleetError."""
        gateway = self._jump(target.jump) if target.jump else None
        return self._log_in(target, gateway)

    def close(self, connection: fabric.Connection) -> None:
        """End one connection."""
        with self._lock:
            if connection in self._open:
                self._open.remove(connection)
        _close(connection)

    def close_all(self) -> None:
        """End everything, and open nothing any more."""
        with self._lock:
            self._closed = True
            connections, self._open = self._open, []
        # The robots' before those that carry them.
        for connection in reversed(connections):
            _close(connection)

    def _jump(self, target: Target) -> fabric.Connection:
        with self._lock:
            jump = self._jumps.setdefault(target, Jump(Lock()))
        with jump.lock:
            # What one robot has found out about its jump host holds for the others of this run.
            if jump.problem:
                raise jump.problem
            if jump.connection is None or not jump.connection.is_connected:
                try:
                    jump.connection = self.open(target)
                except FleetError as problem:
                    jump.problem = problem
                    raise
            return jump.connection

    def _log_in(self, target: Target, gateway: fabric.Connection | None) -> fabric.Connection:
        check = HostKeyCheck(target, accept_new=self._accept_new)
        identities = Identities(target)
        connection = _connection(target, gateway, check, identities)
        try:
            connection.open()
            connection.transport.set_keepalive(KEEPALIVE_S)
        except FleetError:
            connection.client.close()
            raise
        except (OSError, EOFError, paramiko.SSHException) as error:
            connection.client.close()
            raise explain(error, target, identities) from error
        finally:
            identities.close()
        with self._lock:
            if not self._closed:
                self._open.append(connection)
                return connection
        _close(connection)
        raise FleetError(f"cannot reach {target.name}: the run is over")


def _close(connection: fabric.Connection) -> None:
    """Disconnect, if the other end still reads."""
    with suppress(OSError, EOFError, paramiko.SSHException):
        connection.close()


class JumpedConnection(fabric.Connection):  # type: ignore[misc] # fabric has no types
    """A connection whose end wakes all who wait for it, also when its jump host's connection has ended first.

    paramiko closes the channel beneath before it wakes them, and a channel of a connection that has ended raises.
    """

    def open_gateway(self) -> paramiko.Channel:
        """Return the channel through the jump host."""
        channel = super().open_gateway()
        close = channel.close

        def close_quietly() -> None:
            with suppress(OSError, EOFError):
                close()

        channel.close = close_quietly
        return channel


def _connection(
    target: Target, gateway: fabric.Connection | None, check: HostKeyCheck, identities: Identities
) -> fabric.Connection:
    """Make a connection that asks neither files nor the environment about anything."""
    connection = JumpedConnection(
        target.host,
        user=target.user,
        port=target.port,
        config=fabric.Config(lazy=True, ssh_config=paramiko.SSHConfig()),
        gateway=gateway or False,
        forward_agent=False,
        connect_timeout=max(1, round(target.connect_timeout_s)),
        connect_kwargs={
            "auth_strategy": identities,
            "disabled_algorithms": {"keys": check.unwanted_algorithms()},
            "banner_timeout": target.connect_timeout_s,
            "auth_timeout": LOGIN_TIMEOUT_S,
            "channel_timeout": target.connect_timeout_s,
        },
    )
    connection.client.set_missing_host_key_policy(check)
    return connection


def explain(error: Exception, target: Target, identities: Identities) -> FleetError:
    """Return what kept a login from its end, as a sentence."""
    if isinstance(error, paramiko.AuthenticationException):
        return _login_refused(target, identities)
    if isinstance(error, paramiko.ssh_exception.IncompatiblePeer) and "host key" in str(error):
        return changed(target)
    if isinstance(error, paramiko.ChannelException) and error.code == PROHIBITED:
        return FleetError(
            f"cannot reach {target.name}: the server does not let you reach its shell; "
            "you need a grant to manage it, and its shell must be on"
        )
    return FleetError(f"cannot reach {target.name}: {_describe_error(error, target)}")


def _describe_error(error: Exception, target: Target) -> str:
    match error:
        case paramiko.ChannelException(code=code) if code == CONNECT_FAILED:
            why = "it is offline: the server has no tunnel to it"
        case socket.gaierror():
            why = f"there is no host {target.host}"
        case TimeoutError():
            why = f"no answer within {target.connect_timeout_s:g} s"
        case paramiko.ssh_exception.NoValidConnectionsError():
            why = f"nothing answers at {_where(target)}"
        case EOFError():
            why = "it closed the connection during the login"
        case paramiko.SSHException() if "banner" in str(error):
            why = f"no SSH server answers at {_where(target)}"
        case OSError():
            why = reason_in(error)
        case _:
            why = str(error)
    return why


def _where(target: Target) -> str:
    return f"port {target.port} of {target.jump.host if target.jump else target.host}"


def _login_refused(target: Target, identities: Identities) -> FleetError:
    if identities.locked:
        files = " ".join(str(path) for path in identities.locked)
        advice = f"unlock your key first: ssh-add {files}"
    elif not identities.tried:
        advice = "you have no SSH key here: ssh-keygen -t ed25519"
    else:
        advice = f"it accepts none of your {identities.tried} keys; does ssh {target.name} work?"
    return FleetError(f"cannot log in to {target.name} as {target.user}: {advice}")
