"""Bare machines that playbooks make into a server: Debian with systemd, with a Docker of its own inside."""

from __future__ import annotations

import os
import re
import sys
from dataclasses import dataclass
from pathlib import Path

from commands import output_of_command, run_command
from docker.types import Mount
from image_names import image
from robot_hosts import ROOT, SYSTEMD, RobotHost, RobotHosts

FOLDER = "/opt/robotether"
IMAGES = [image(name) for name in ("mysql", "sshd", "nginx", "acme", "server")]
# A container's /proc/sys is read-only, and Docker inside it sets its bridges up there.
DROP_IN = b"[Service]\nExecStartPre=/bin/mount -o remount,rw,bind /proc/sys\n"
RECAP = re.compile(r"changed=(\d+)\s+unreachable=(\d+)\s+failed=(\d+)")


def image_tag() -> str:
    return IMAGES[0].partition(":")[2]


def save_images(folder: Path) -> Path:
    archive = folder / "images.tar"
    output_of_command("docker", "save", "--output", archive, *IMAGES, limit_s=300)
    return archive


def clone_sources(folder: Path) -> Path:
    """This checkout's commit: one made while the tests run would be an upgrade."""
    sources = folder / "sources"
    output_of_command("git", "clone", "--quiet", ROOT, sources)
    return sources


def boot_docker_host(hosts: RobotHosts, name: str) -> RobotHost:
    host = hosts.boot(
        name,
        # overlay2 needs another file system than the container's own; runc needs to look into what it started.
        mounts=[Mount("/var/lib/docker", None, type="volume")],
        cap_add=[*SYSTEMD["cap_add"], "SYS_PTRACE"],
    )
    host.put(DROP_IN, "/etc/systemd/system/docker.service.d/container.conf")
    return host


def boot_machine(hosts: RobotHosts, name: str) -> RobotHost:
    host = boot_docker_host(hosts, name)
    host.run("systemctl disable --now sim-robot")
    return host


def compose(host: RobotHost, arguments: str) -> str:
    return host.run(f"cd {FOLDER} && tools/compose {arguments}")


def are_healthy(host: RobotHost, services: set[str]) -> bool:
    if not host.succeeds("docker info"):
        return False
    listed = compose(host, "ps --format '{{.Service}} {{.Health}}'").split("\n")
    return {line.split()[0] for line in listed if line.endswith(" healthy")} == services


def secrets_of(host: RobotHost) -> str:
    return host.run(f"sha256sum {FOLDER}/compose/secrets/*")


@dataclass(frozen=True)
class Controller:
    playbook: str
    inventory: Path
    sources: Path

    def play(self, *arguments: str) -> tuple[int, str]:
        """Run the playbook, which must end well; how much it changed on all machines, and what it printed."""
        program = Path(sys.executable).with_name("ansible-playbook")
        done = run_command(
            *(str(program), "-i", str(self.inventory), self.playbook, *arguments),
            cwd=self.sources / "ansible",
            env={**os.environ, "ANSIBLE_NOCOLOR": "1"},
            limit_s=1800,
        )
        recaps = RECAP.findall(done.stdout)
        assert recaps, done.stdout[-6000:] + done.stderr
        ended = {(unreachable, failed) for _, unreachable, failed in recaps}
        assert ended == {("0", "0")}, done.stdout[-6000:] + done.stderr
        assert done.returncode == 0, done.stdout[-6000:] + done.stderr
        return sum(int(changed) for changed, _, _ in recaps), done.stdout
