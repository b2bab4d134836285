"""Real sshds for tests of `robotether fleet`: a jump host and robots behind it, with an ssh_config that reaches them.

All listen on 127.0.0.1 as whoever runs the tests. The jump host opens exactly the robots' ports, as the server's
image does; robots let a person's key in and run what it asks.
"""

from __future__ import annotations

import getpass
import subprocess
import textwrap
from dataclasses import dataclass, field
from pathlib import Path

from local_network import free_port
from openssh_server import listens, make_key, start_sshd, stop_sshd, wait_until


@dataclass
class ShellHost:
    folder: Path
    rules: str
    port: int = field(default_factory=free_port)
    host_key: str = ""
    _process: subprocess.Popen[bytes] | None = None

    @property
    def authorized(self) -> Path:
        return self.folder / "authorized_keys"

    def start(self) -> None:
        self.folder.mkdir(exist_ok=True)
        if not (self.folder / "host_key").exists():
            make_key(self.folder / "host_key")
        self.host_key = (self.folder / "host_key.pub").read_text().strip()
        self._process = start_sshd(self.folder, self._config())
        wait_until(lambda: listens(self.port), lambda: f"sshd listens:\n{self.log()}", within_s=10)

    def log(self) -> str:
        return (self.folder / "log").read_text(errors="replace")

    def new_host_key(self) -> None:
        self.stop()
        for name in ("host_key", "host_key.pub"):
            (self.folder / name).unlink()
        self.start()

    def stop(self) -> None:
        if self._process is not None:
            stop_sshd(self._process)
            self._process = None

    def _config(self) -> str:
        fixed = f"""
            ListenAddress 127.0.0.1
            Port {self.port}
            HostKey {self.folder}/host_key
            AuthorizedKeysFile {self.authorized}
            AuthenticationMethods publickey
            PermitRootLogin prohibit-password
            UsePAM no
            StrictModes no
            PidFile none
            LogLevel VERBOSE
            # Whoever runs the tests may have start-up files that take their time or print something.
            SetEnv HOME={self.folder}
            """
        return textwrap.dedent(fixed) + self.rules + "\n"


@dataclass
class ShellNetwork:
    folder: Path
    robots: dict[str, ShellHost] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.user = getpass.getuser()
        self.public_key = make_key(self.folder / "id")
        self.jump = ShellHost(self.folder / "jump", "AllowTcpForwarding local\nPermitTTY no")

    @property
    def config(self) -> Path:
        return self.folder / "ssh_config"

    @property
    def known_hosts(self) -> Path:
        return self.folder / "known_hosts"

    @property
    def jump_address(self) -> str:
        return f"[127.0.0.1]:{self.jump.port}"

    def start(self, *names: str) -> None:
        self.jump.start()
        for name in names:
            robot = self.robots[name] = ShellHost(self.folder / name, "AllowTcpForwarding no")
            robot.start()
            robot.authorized.write_text(f"{self.public_key}\n")
        self.let_through(*names)
        self.trust()
        self.write_config()

    def let_through(self, *names: str) -> None:
        opens = "".join(f',permitopen="127.0.0.1:{self.robots[name].port}"' for name in names)
        self.jump.authorized.write_text(f"restrict,port-forwarding{opens} {self.public_key}\n")

    def trust(self) -> None:
        lines = [f"{self.jump_address} {self.jump.host_key}"]
        lines += [f"robotether-{name} {robot.host_key}" for name, robot in self.robots.items()]
        self.known_hosts.write_text("\n".join(lines) + "\n")

    def write_config(self) -> None:
        entries = [
            f"Host {name}\n    HostName 127.0.0.1\n    Port {robot.port}\n    User {self.user}\n"
            f"    HostKeyAlias robotether-{name}\n    ProxyJump {self.user}@127.0.0.1:{self.jump.port}\n"
            for name, robot in self.robots.items()
        ]
        own = f"""
Host elsewhere
    HostName 127.0.0.1
Host *
    IdentityFile {self.folder}/id
    IdentitiesOnly yes
    UserKnownHostsFile {self.known_hosts}
    GlobalKnownHostsFile /dev/null
    ConnectTimeout 10
"""
        self.config.write_text("\n".join(entries) + own)

    def stop(self) -> None:
        for host in (self.jump, *self.robots.values()):
            host.stop()
