"""A real sshd for tests: unprivileged or as root, on 127.0.0.1 unless told otherwise, set up as the server's image is.

Its forced command joins a robot's session to a fake relay and, as the real one does, ends its own sshd when
either side ends. The user is whoever runs the tests, because sshd can log in nobody else without root.
"""

from __future__ import annotations

import getpass
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import textwrap
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

from local_network import free_port

PROC = Path("/proc")


def words_of(pid: int, proc: Path = PROC) -> list[str]:
    """Those of proc(5) behind the name, from the state on; OSError when there is no such process any more."""
    return (proc / str(pid) / "stat").read_text().rpartition(")")[2].split()


def words_of_all(proc: Path = PROC) -> Iterator[tuple[int, list[str]]]:
    for path in proc.iterdir():
        # Not by a pattern: pathlib stumbles over a process that ends while it looks.
        if not path.name.isdigit():
            continue
        try:
            words = words_of(int(path.name), proc)
        except (FileNotFoundError, ProcessLookupError):
            continue
        yield int(path.name), words


SSHD = Path("/usr/sbin/sshd")
WAIT_S = 30.0
T = TypeVar("T")

# Runs once for each session; told by its arguments where the fake relay is.
SESSION_COMMAND = """
import json, os, selectors, signal, socket, sys

def end_connection():
    if os.getppid() > 1:  # which would be the machine's init, after sshd has gone
        os.kill(os.getppid(), signal.SIGTERM)
    sys.exit(0)

sys.stderr.write("a notice of the log-in\\n")
relay_port, robot_id = int(sys.argv[1]), int(sys.argv[2])
kind = os.environ.get("SSH_ORIGINAL_COMMAND", "")
try:
    relay = socket.create_connection(("127.0.0.1", relay_port))
except OSError as error:
    sys.stderr.write(f"robotether: cannot reach the relay: {error}\\n")
    sys.exit(1)
address = os.environ["SSH_CONNECTION"].split()[0]
preface = {"type": "preface", "kind": kind, "robot_id": robot_id, "address": address}
preface["fingerprint"], preface["ports"] = "SHA256:of the tests", []
preface["session_key"] = sys.argv[3]
relay.sendall(json.dumps(preface).encode() + b"\\n")
waiting = selectors.DefaultSelector()
waiting.register(0, selectors.EVENT_READ, lambda data: relay.sendall(data))
waiting.register(relay, selectors.EVENT_READ, lambda data: os.write(1, data))
while True:
    for key, _ in waiting.select():
        try:
            data = os.read(key.fd, 65536)
            if not data:
                end_connection()
            key.data(data)
        except OSError:
            end_connection()
"""


class Sshd:
    """One sshd with its files in a folder; `rules` are the lines of its configuration that no other has."""

    def __init__(self, folder: Path, rules: str, address: str = "127.0.0.1") -> None:
        if not SSHD.exists():
            raise RuntimeError(
                f"cannot start an SSH server: {SSHD} is missing; install openssh-server"
            )
        folder.mkdir(exist_ok=True)
        self.folder, self._rules, self.address = folder, rules, address
        self.port, self.user = free_port(), getpass.getuser()
        self.authorized = folder / "authorized_keys"
        self._process: subprocess.Popen[bytes] | None = None
        self.new_host_key()

    @property
    def host_key(self) -> str:
        return (self.folder / "host_key.pub").read_text().strip()

    def new_host_key(self) -> None:
        path = self.folder / "host_key"
        path.unlink(missing_ok=True)
        make_key(path)

    def start(self) -> None:
        if os.geteuid() == 0:
            Path("/run/sshd").mkdir(mode=0o755, exist_ok=True)
        config = self.folder / "sshd_config"
        config.write_text(textwrap.dedent(self._config()) + textwrap.dedent(self._rules))
        with (self.folder / "log").open("ab") as log:
            self._process = subprocess.Popen(
                [str(SSHD), "-D", "-e", "-f", str(config)], stderr=log, stdin=subprocess.DEVNULL
            )
        wait_until(self._listens, lambda: f"sshd listens; its log:\n{self.log_text()}")

    def stop(self) -> None:
        if self._process is None:
            return
        # Held first, so that a client that comes back at once starts no process that is not in the list.
        self._process.send_signal(signal.SIGSTOP)
        connections = descendants(self._process.pid)
        self._process.kill()
        self._process.wait(WAIT_S)
        for pid in connections:
            kill(pid)
        wait_until(lambda: not any(map(is_alive, connections)), lambda: "its children have ended")
        self._process = None

    def pids(self) -> list[int]:
        own = self._process
        return [] if own is None else [own.pid, *descendants(own.pid)]

    def log_text(self) -> str:
        path = self.folder / "log"
        return path.read_text(errors="replace") if path.exists() else ""

    def _listens(self) -> bool:
        assert self._process is not None
        if self._process.poll() is not None:
            raise RuntimeError(f"sshd did not start:\n{self.log_text()}")
        return listens(self.port, self.address)

    def _config(self) -> str:
        return f"""
            ListenAddress {self.address}
            Port {self.port}
            HostKey {self.folder}/host_key
            AuthorizedKeysFile {self.authorized}
            AuthenticationMethods publickey
            PermitRootLogin prohibit-password
            PasswordAuthentication no
            KbdInteractiveAuthentication no
            UsePAM no
            StrictModes no
            PidFile none
            LogLevel VERBOSE
            """


# The forwards of the server's image. Without the last line bash takes the session command for a log-in and runs the
# person's own .bashrc first.
TUNNEL_RULES = """
    GatewayPorts clientspecified
    AllowTcpForwarding remote
    AllowStreamLocalForwarding no
    PermitTTY no
    MaxSessions 2
    SetEnv SHLVL=2
    """


class OpenSshServer(Sshd):
    """The server's sshd; `port` is where it listens, `host_keys` what a client may pin."""

    def __init__(
        self, relay_port: int, *, address: str = "127.0.0.1", session_key: str = "none"
    ) -> None:
        super().__init__(Path(tempfile.mkdtemp(prefix="rt-sshd-")), TUNNEL_RULES, address)
        self._relay_port = relay_port
        self._session_key = session_key
        self.authorized.touch(0o600)
        (self.folder / "session.py").write_text(SESSION_COMMAND)

    @property
    def host_keys(self) -> list[str]:
        return [self.host_key]

    def take_host_key(self, other: OpenSshServer) -> None:
        for name in ("host_key", "host_key.pub"):
            shutil.copy(other.folder / name, self.folder / name)

    def authorize(self, public_key: str, ports: tuple[int, ...]) -> None:
        """Let a robot's key in and no other, with the line that the key look-up prints."""
        self.authorized.write_text(self._line(public_key, ports, robot_id=7))

    def authorize_too(self, public_key: str, ports: tuple[int, ...], robot_id: int) -> None:
        with self.authorized.open("a") as lines:
            lines.write(self._line(public_key, ports, robot_id))

    def _line(self, public_key: str, ports: tuple[int, ...], robot_id: int) -> str:
        listens = ",".join(f'permitlisten="*:{port}"' for port in ports)
        script = self.folder / "session.py"
        command = f"exec {sys.executable} -S -E {script} {self._relay_port} {robot_id}"
        command += f" '{self._session_key}'"
        return f'restrict,port-forwarding,{listens},command="{command}" {public_key}\n'

    def drop_connections(self) -> None:
        for pid in self.pids()[1:]:
            kill(pid)

    def close(self) -> None:
        self.stop()
        shutil.rmtree(self.folder)


def make_key(
    path: Path, passphrase: str = "", *, kind: str = "ed25519", bits: int = 0, comment: str = ""
) -> str:
    command = ["ssh-keygen", "-q", "-t", kind, "-N", passphrase, "-C", comment, "-f", str(path)]
    command += ["-b", str(bits)] if bits else []
    subprocess.run(command, check=True, stdin=subprocess.DEVNULL)
    return path.with_suffix(".pub").read_text().strip()


def listens(port: int, address: str = "127.0.0.1") -> bool:
    with socket.socket() as probe:
        probe.settimeout(1)
        return probe.connect_ex((address, port)) == 0


def wait_until(
    condition: Callable[[], T],
    what: Callable[[], str],
    within_s: float = WAIT_S,
    every_s: float = 0.02,
) -> T:
    """Wait, bounded, until the condition gives something true; `what()` tells in the failure what was waited for."""
    deadline = time.monotonic() + within_s
    while not (got := condition()):
        if time.monotonic() > deadline:
            raise AssertionError(f"not within {within_s:g} s: {what()}")
        time.sleep(every_s)
    return got


def descendants(pid: int) -> list[int]:
    parents = {child: int(parent) for child, (state, parent, *_) in words_of_all() if state != "Z"}
    found, frontier = [], [pid]
    while frontier:
        above = frontier.pop()
        below = [child for child, parent in parents.items() if parent == above]
        found += below
        frontier += below
    return found


def is_alive(pid: int) -> bool:
    try:
        return words_of(pid)[0] != "Z"
    except OSError:
        return False


def kill(pid: int) -> None:
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        return


def command_line(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_text().replace("\0", " ")
    except OSError:
        return "(ended)"
