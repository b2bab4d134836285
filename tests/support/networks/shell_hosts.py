"""Real sshds for tests of `robotether fleet`: a jump host and robots behind it, with an ssh_config that reaches them.

All listen on 127.0.0.1 as whoever runs the tests. The jump host opens exactly the robots' ports, as the server's
image does; robots let a person's key in and run what it asks.
"""

from __future__ import annotations

import getpass
from dataclasses import dataclass, field
from pathlib import Path

from openssh_server import Sshd, make_key


class ShellHost(Sshd):
    def __init__(self, folder: Path, rules: str) -> None:
        # Whoever runs the tests may have start-up files that take their time or print something.
        super().__init__(folder, f"SetEnv HOME={folder}\n{rules}\n")

    def come_back_as_another(self) -> None:
        """Have another host key, which a new installation has, and an attacker."""
        self.stop()
        self.new_host_key()
        self.start()


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
