"""ansible/server.yml, run for real: a bare Debian with systemd becomes the server, with a Docker of its own inside."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from docker.types import Mount
from image_names import image
from robot_hosts import ROOT, SYSTEMD, RobotHost, RobotHosts

pytestmark = pytest.mark.release
FOLDER = "/opt/robotether"
SERVICES = {"mysql", "nginx", "relay", "sshd", "web"}
IMAGES = [image(name) for name in ("mysql", "sshd", "nginx", "acme", "server")]
# A container's /proc/sys is read-only, and Docker inside it sets its bridges up there.
DROP_IN = b"[Service]\nExecStartPre=/bin/mount -o remount,rw,bind /proc/sys\n"
RECAP = re.compile(r"changed=(\d+)\s+unreachable=(\d+)\s+failed=(\d+)")


@dataclass
class Server:
    """The machine, and the inventory that names it."""

    host: RobotHost
    inventory: Path
    sources: Path

    def play(self, *arguments: str) -> tuple[int, str]:
        """Run server.yml; how much it changed, and what it printed."""
        playbook = Path(sys.executable).with_name("ansible-playbook")
        done = subprocess.run(
            [playbook, "-i", str(self.inventory), "server.yml", *arguments],
            cwd=self.sources / "ansible",
            env={**os.environ, "ANSIBLE_NOCOLOR": "1"},
            check=False,
            capture_output=True,
            text=True,
            timeout=600,
        )
        recap = RECAP.search(done.stdout)
        assert recap, done.stdout[-6000:] + done.stderr
        assert (recap[2], recap[3]) == ("0", "0"), done.stdout[-6000:] + done.stderr
        return int(recap[1]), done.stdout

    def compose(self, arguments: str) -> str:
        return self.host.run(f"cd {FOLDER} && tools/compose {arguments}")

    def healthy(self) -> bool:
        """Tell whether Docker calls all services healthy."""
        if not self.host.succeeds("docker info"):
            return False
        listed = self.compose("ps --format '{{.Service}} {{.Health}}'").split("\n")
        return {line.split()[0] for line in listed if line.endswith(" healthy")} == SERVICES

    def secrets(self) -> str:
        return self.host.run(f"sha256sum {FOLDER}/compose/secrets/*")


@pytest.fixture(scope="module")
def server(hosts: RobotHosts, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A bare machine; its images are handed over, as on a site without internet."""
    folder = tmp_path_factory.mktemp("server")
    images = folder / "images.tar"
    subprocess.run(["docker", "save", "--output", str(images), *IMAGES], check=True, timeout=300)
    host = hosts.boot(
        "cloud-vm",
        # overlay2 needs another file system than the container's own; runc needs to look into what it started.
        mounts=[Mount("/var/lib/docker", None, type="volume")],
        cap_add=[*SYSTEMD["cap_add"], "SYS_PTRACE"],
    )
    host.run("systemctl disable --now sim-robot")
    host.put(DROP_IN, "/etc/systemd/system/docker.service.d/container.conf")
    inventory = folder / "server.ini"
    tag = IMAGES[0].partition(":")[2]
    settings = f'{{"PUBLIC_HOST": "robots.test", "JOIN_POLICY": "token-only", "TAG": "{tag}"}}'
    inventory.write_text(
        f"[robotether_server]\n{host.inventory_line(robotether_server_settings=settings)}\n"
        f"[robotether_server:vars]\nrobotether_server_images={images}\n"
    )
    # A commit made while the tests run would be an upgrade.
    sources = folder / "sources"
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(sources)], check=True, timeout=60)
    yield Server(host, inventory, sources)
    images.unlink()


def test_check_works_before_the_first_run(server: Server) -> None:
    """--check on a bare machine ends well and changes nothing."""
    before = server.host.run("ls /opt /etc /etc/systemd/system")
    server.play("--check")
    assert server.host.run("ls /opt /etc /etc/systemd/system") == before


def test_bare_machine_becomes_the_server_once(server: Server) -> None:
    """The first run ends with a healthy stack and prints its fingerprint; the second changes nothing."""
    changed, said = server.play()
    assert changed > 0
    assert "https://robots.test/" in said
    assert re.search(r"SHA-256 ([0-9A-F]{2}:){31}", said)
    assert server.healthy()
    assert "admin" in server.compose("exec -T web robotether user list")
    assert "token-only" in server.compose("exec -T web printenv JOIN_POLICY")
    password = server.host.run(f"cat {FOLDER}/compose/secrets/admin_password")
    assert password not in said

    secrets = server.secrets()
    changed, said = server.play()
    assert changed == 0, said
    changed, said = server.play("--check")
    assert changed == 0, said
    assert server.secrets() == secrets


def test_firewall_admits_what_it_should(server: Server) -> None:
    """Only SSH and the stack's ports answer from outside; local accounts reach no container but by published ports."""
    host = server.host
    host.container.reload()
    (network,) = host.container.attrs["NetworkSettings"]["Networks"].values()
    address = network["IPAddress"]
    host.run("systemd-run --unit open-port python3 -m http.server 9999")
    host.wait("port 9999", lambda: host.succeeds("curl -s -m 3 http://127.0.0.1:9999/"))
    assert _answers(f"https://{address}/login")
    assert not _answers(f"http://{address}:9999/")

    addresses = "{{range .NetworkSettings.Networks}}{{.IPAddress}} {{end}}"
    sshd = host.run(f"docker inspect -f '{addresses}' robotether-sshd-1").split()
    assert sshd
    for ip in sshd:
        connects = f"timeout 3 bash -c '</dev/tcp/{ip}/2222'"
        assert host.succeeds(connects)
        assert not host.succeeds(f"runuser -u pi -- {connects}")
    for name in ("127.0.0.1", address):
        assert host.succeeds(f"runuser -u pi -- curl -fsk -m 5 https://{name}/login")
    # The timer that would have taken the rules back is gone.
    assert not host.succeeds("systemctl is-active robotether-firewall-undo.timer")


def test_upgrade_dumps_the_database_first(server: Server) -> None:
    """Another version leaves a dump that can be put back, and the newest dumps only."""
    server.compose("exec -T web robotether robot add kept --mac 00:1b:44:11:3a:b7")
    secrets = server.secrets()
    dumps = "/var/backups/robotether"
    for _ in range(2):
        server.host.run(f"echo 'older built' > {FOLDER}/compose/.deployed")
        server.play("-e", "robotether_server_dumps_kept=1")
    assert server.secrets() == secrets
    found = server.host.run(f"ls {dumps}").split()
    assert len(found) == 1
    server.compose("exec -T web robotether robot remove kept --yes")
    # As docs/howto/server.md says.
    server.compose("stop nginx web relay sshd")
    server.compose(
        f"exec -T mysql mariadb --defaults-file=/etc/mysql/mariadb.cnf < <(zcat {dumps}/{found[0]})"
    )
    server.host.run(f"cd {FOLDER} && tools/up --no-build")
    assert "kept" in server.compose("exec -T web robotether robot list")


def test_stack_and_firewall_come_back_at_boot(server: Server) -> None:
    """After a reboot nobody has to do anything."""
    server.host.reboot()
    server.host.wait_booted()
    server.host.wait("the stack healthy", server.healthy, seconds=120)
    assert "robotether" in server.host.run("nft list tables")


def _answers(url: str) -> bool:
    command = ["curl", "-sk", "-m", "4", "-o", "/dev/null", url]
    return subprocess.run(command, check=False, timeout=10).returncode == 0
