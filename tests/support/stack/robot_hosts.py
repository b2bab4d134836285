"""Robots' computers for the tests of playbooks and installer: Debian with systemd, booted in a container.

A host has SSH, Python and a simulated ROS (images/robot_host), an interface with a MAC of a maker, and no agent. It
reaches the server that is published on this machine as `cloud`, and the internet as this machine does.
"""

from __future__ import annotations

import io
import itertools
import os
import shlex
import socket
import subprocess
import tarfile
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self, TypeVar

import docker
from docker.models.containers import Container
from docker_engine import machine_address
from inside import run_inside
from local_network import free_port
from openssh_server import make_key, wait_until

ROOT = Path(__file__).resolve().parents[3]
PREFIX = f"robot-host-{os.getpid()}"
IMAGE = "local.invalid/robotether/robot_host:bookworm"
USER = "pi"
# In every host, so that pip there trusts what this machine trusts; a site behind an inspecting proxy does the same.
CA_BUNDLE = "/etc/ssl/site-ca.pem"
# What the agent needs, in the image.
WHEELHOUSE = "/opt/wheelhouse"
VIDEO_WHEELHOUSE = "/opt/wheelhouse-video"
# What systemd needs beyond Docker's usual: to mount, and its own control group, on cgroup v1 and v2.
SYSTEMD: dict[str, Any] = {
    "cap_add": ["SYS_ADMIN", "NET_ADMIN"],
    "security_opt": ["seccomp=unconfined"],
    "tmpfs": {"/run": "", "/run/lock": ""},
    "cgroupns": "host",
    "tty": True,
    # Half of Docker's default: what is installed can wait for the drives that are tested beside it.
    "cpu_shares": 512,
}
# What of this machine a host sees.
VOLUMES = {"/sys/fs/cgroup": {"bind": "/sys/fs/cgroup", "mode": "rw"}}
BOOTING_AT_ONCE, BOOTS_WITHIN_S = 4, 60.0
EXEC_LIMIT_S = 600.0
# All modules of a run share one server, which knows a robot by its MAC.
NUMBERS = itertools.count()
T = TypeVar("T")


class CommandError(AssertionError):
    pass


NEWER_IMAGE = "local.invalid/robotether/robot_host:trixie"


def newer_systemd_boots() -> bool:
    """Tell whether systemd 257 (Debian 13) can boot in a container here: it needs the host's cgroup v2."""
    return Path("/sys/fs/cgroup/cgroup.controllers").exists()


@dataclass
class RobotHost:
    name: str
    mac: str
    ssh_port: int
    container: Container
    key: Path

    def run(self, command: str, *, check: bool = True, stdin: str | None = None) -> str:
        done = self._exec(command, stdin)
        if check and done.returncode != 0:
            raise CommandError(f"{self.name}: {command!r} exited {done.returncode}\n{done.stdout}")
        return done.stdout

    def succeeds(self, command: str) -> bool:
        return self._exec(command).returncode == 0

    def _exec(self, command: str, stdin: str | None = None) -> subprocess.CompletedProcess[str]:
        wanted = ("bash", "-c", command)
        return run_inside(
            self.container, *wanted, stdin=stdin or "", merged=True, limit_s=EXEC_LIMIT_S
        )

    def put(self, content: bytes, path: str, mode: int = 0o644) -> None:
        buffer = io.BytesIO()
        with tarfile.open(fileobj=buffer, mode="w") as archive:
            entry = tarfile.TarInfo(path.lstrip("/"))
            entry.size, entry.mode = len(content), mode
            archive.addfile(entry, io.BytesIO(content))
        assert self.container.put_archive("/", buffer.getvalue())

    def ros_listens_on(self, address: str) -> None:
        """Let the simulated ROS listen there: on 0.0.0.0 as ROS does by itself, or 127.0.0.1 as at first."""
        setting = f"[Service]\nEnvironment=SIM_BIND_ADDRESS={address}\n"
        self.put(setting.encode(), "/etc/systemd/system/sim-robot.service.d/address.conf")
        self.run("systemctl daemon-reload && systemctl restart sim-robot")
        self.wait("rosbridge listens", lambda: self.succeeds("exec 3<>/dev/tcp/127.0.0.1/9090"))

    def footprint(self) -> set[str]:
        """Every lasting file outside of people's homes, with its owner and mode, and all users and groups.

        What differs before and after is what was left behind. Left out is what the host itself writes all the time.
        """
        found = self.run(
            "find / -xdev \\( -path /home -o -path /root -o -path /tmp -o -path /var/tmp -o -path /var/log"
            " -o -path /var/cache -o -path /var/lib/systemd -o -path /var/lib/private"
            " -o -path /var/lib/docker -o -path /var/lib/containerd \\) -prune"
            " -o -printf '%p %M %u:%g\\n'"
            " | grep -v __pycache__; cut -d: -f1,3 /etc/passwd /etc/group"
        )
        return set(found.splitlines())

    def reboot(self) -> None:
        """Switch it off and on in an orderly way; returns when the power is on, not when it has booted."""
        self.container.restart(timeout=30)

    def switch_off(self) -> None:
        self.container.kill()

    def switch_on(self) -> None:
        self.container.start()

    def wait_booted(self) -> None:
        # systemd waits for itself; to ask again and again would slow down hosts that boot beside each other.
        started = "timeout 10 systemctl is-system-running --wait"
        self.wait("systemd running", lambda: self.succeeds(started), BOOTS_WITHIN_S)
        self.wait("SSH answers", self.greets, BOOTS_WITHIN_S)

    def wait(self, what: str, condition: Callable[[], T], seconds: float = 30) -> T:
        def report() -> str:
            journal = self.run("journalctl --no-pager -n 60; systemctl --failed", check=False)
            return f"{what} on {self.name}\n{journal}"

        return wait_until(condition, report, seconds, every_s=0.1)

    @property
    def ssh(self) -> list[str]:
        """The command that logs in as the user who may use sudo; append a command for the host."""
        options = ["StrictHostKeyChecking=no", "UserKnownHostsFile=/dev/null", "LogLevel=ERROR"]
        quiet = [word for option in options for word in ("-o", option)]
        return [
            "ssh",
            *quiet,
            "-i",
            str(self.key),
            "-p",
            str(self.ssh_port),
            f"{USER}@127.0.0.1",
        ]

    def inventory_line(self, **variables: Any) -> str:
        ours = {
            "ansible_host": "127.0.0.1",
            "ansible_port": str(self.ssh_port),
            "ansible_user": USER,
            "ansible_ssh_private_key_file": str(self.key),
            # A robot's host key is pinned by its first login; these hosts are new each time, at the same address.
            "ansible_ssh_common_args": "-o StrictHostKeyChecking=no -o UserKnownHostsFile=/dev/null",
            **variables,
        }
        return " ".join(
            [self.name, *(f"{key}={shlex.quote(str(value))}" for key, value in ours.items())]
        )

    def greets(self) -> bool:
        try:
            with socket.create_connection(("127.0.0.1", self.ssh_port), timeout=2) as connection:
                return connection.recv(4) == b"SSH-"
        except OSError:
            return False


@dataclass
class RobotHosts:
    """The hosts of one test module, on a network of their own; all are removed at the end."""

    folder: Path
    engine: docker.DockerClient = field(default_factory=docker.from_env)
    booted: list[RobotHost] = field(default_factory=list)

    def __enter__(self) -> Self:
        self.network = self.engine.networks.create(f"{PREFIX}-{id(self)}", driver="bridge")
        self.key = self.folder / "robot_hosts_key"
        make_key(self.key)
        return self

    def __exit__(self, *_: object) -> None:
        for host in list(self.booted):
            self.remove(host)
        self.network.remove()

    @property
    def server_host(self) -> str:
        """The address of this machine that both its own programs and the hosts reach."""
        return machine_address(self.engine)

    def boot(self, name: str, *, image: str = IMAGE, **options: Any) -> RobotHost:
        """Boot a new host and wait until it takes logins; `options` go to Docker.

        With a `command` among the options that runs in place of systemd, and nobody waits for it.
        """
        mac = _new_mac()
        ssh_port = free_port()
        container = self.engine.containers.create(
            image,
            name=f"{PREFIX}-{name}-{ssh_port}",
            hostname=name,
            extra_hosts={"cloud": "host-gateway"},
            ports={"22/tcp": ("127.0.0.1", ssh_port)},
            mac_address=mac,
            network=self.network.name,
            volumes=VOLUMES,
            **{**SYSTEMD, **options},
        )
        host = RobotHost(name, mac, ssh_port, container, self.key)
        self.booted.append(host)
        container.start()
        self._authorize_ssh(host)
        if "command" not in options:
            host.wait_booted()
        return host

    def boot_all(
        self, *names: str, options: Mapping[str, dict[str, Any]] | None = None
    ) -> list[RobotHost]:
        given = options or {}
        with ThreadPoolExecutor(BOOTING_AT_ONCE) as pool:
            return list(pool.map(lambda name: self.boot(name, **given.get(name, {})), names))

    def remove(self, host: RobotHost) -> None:
        self.booted.remove(host)
        host.container.remove(force=True, v=True)

    def _authorize_ssh(self, host: RobotHost) -> None:
        public = self.key.with_suffix(".pub").read_bytes()
        host.put(public, "/home/pi/.ssh/authorized_keys")
        host.run(f"chown {USER}:{USER} /home/{USER}/.ssh/authorized_keys")
        bundle = os.environ.get("SSL_CERT_FILE") or "/etc/ssl/certs/ca-certificates.crt"
        if Path(bundle).exists():
            host.put(Path(bundle).read_bytes(), CA_BUNDLE)


def _new_mac() -> str:
    """A MAC as a network card's maker gives it, another one for each host of this run."""
    tail = os.getpid() % 0x10000 * 0x100 + next(NUMBERS)
    return f"00:1b:44:{tail >> 16 & 255:02x}:{tail >> 8 & 255:02x}:{tail & 255:02x}"
