"""Opens SSH connections to robots, all through one connection to each jump host, and says why one cannot be had.

Every connection, a jump host's too, passes HostKeyCheck. Must never use fabric's own gateways, which trust any key.
"""

import socket
from contextlib import suppress
from dataclasses import dataclass
from threading import Lock

import fabric
import paramiko

from robotether_server.cli.fleet.host_keys import HostKeyCheck, changed
from robotether_server.cli.fleet.identities import Identities
from robotether_server.cli.fleet.problems import FleetProblem, LoginRefused, Unreachable
from robotether_server.cli.fleet.ssh_settings import Target

LOGIN_TIMEOUT_S = 30
KEEPALIVE_S = 10
# RFC 4254, 5.1
PROHIBITED = 1
CONNECT_FAILED = 2


@dataclass
class Jump:
    """One jump host: opened by the first robot that needs it, while the others wait."""

    lock: Lock
    connection: fabric.Connection | None = None
    problem: FleetProblem | None = None


class SshConnections:
    """All connections of one run. Safe to use from many threads."""

    def __init__(self, *, accept_new: bool) -> None:
        self._accept_new = accept_new
        self._lock = Lock()
        self._jumps: dict[Target, Jump] = {}
        self._open: list[fabric.Connection] = []
        self._closed = False

    def open(self, target: Target) -> fabric.Connection:
        """Return a connection that is logged in; raise a FleetProblem."""
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
                except FleetProblem as problem:
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
        except FleetProblem:
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
        raise Unreachable(f"cannot reach {target.name}: the run is over")


def _close(connection: fabric.Connection) -> None:
    """Say goodbye, if the other end still listens."""
    with suppress(OSError, EOFError, paramiko.SSHException):
        connection.close()


def _connection(
    target: Target, gateway: fabric.Connection | None, check: HostKeyCheck, identities: Identities
) -> fabric.Connection:
    """Make a connection that asks neither files nor the environment about anything."""
    connection = fabric.Connection(
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


def explain(error: Exception, target: Target, identities: Identities) -> FleetProblem:
    """Return what kept a login from its end, as a sentence."""
    if isinstance(error, paramiko.AuthenticationException):
        return _login_refused(target, identities)
    if isinstance(error, paramiko.ssh_exception.IncompatiblePeer) and "host key" in str(error):
        return changed(target)
    if isinstance(error, paramiko.ChannelException) and error.code == PROHIBITED:
        return LoginRefused(
            f"cannot reach {target.name}: the server does not let you reach its shell; "
            "that takes a grant to manage it, and its shell must be on"
        )
    return Unreachable(f"cannot reach {target.name}: {_why(error, target)}")


def _why(error: Exception, target: Target) -> str:
    match error:
        case paramiko.ChannelException(code=code) if code == CONNECT_FAILED:
            why = "it is offline, the server has no tunnel of it"
        case socket.gaierror():
            why = f"there is no host {target.host}"
        case TimeoutError():
            why = f"no answer within {target.connect_timeout_s:g} s"
        case paramiko.ssh_exception.NoValidConnectionsError():
            why = f"nothing answers at {_where(target)}"
        case EOFError():
            why = "it hung up during the login"
        case paramiko.SSHException() if "banner" in str(error):
            why = f"no SSH server answers at {_where(target)}"
        case _:
            why = str(error)
    return why


def _where(target: Target) -> str:
    return f"port {target.port} of {target.jump.host if target.jump else target.host}"


def _login_refused(target: Target, identities: Identities) -> LoginRefused:
    if identities.locked:
        files = " ".join(str(path) for path in identities.locked)
        advice = f"unlock your key first: ssh-add {files}"
    elif not identities.tried:
        advice = "you have no SSH key here: ssh-keygen -t ed25519"
    else:
        advice = f"it takes none of your {identities.tried} keys; does ssh {target.name} work?"
    return LoginRefused(f"cannot log in to {target.name} as {target.user}: {advice}")
