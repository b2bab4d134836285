"""ansible/server.yml, run for real: a bare Debian with systemd becomes the server, with a Docker of its own inside."""

import re
from dataclasses import dataclass

import pytest
from cloud_machines import (
    FOLDER,
    Controller,
    are_healthy,
    boot_machine,
    clone_sources,
    compose,
    image_tag,
    save_images,
    secrets_of,
)
from commands import run_command
from robot_hosts import RobotHost

pytestmark = pytest.mark.release
SERVICES = {"mysql", "nginx", "recorder", "relay", "sshd", "web"}


@dataclass
class Server:
    """The machine, and the admin's own."""

    host: RobotHost
    controller: Controller

    def compose(self, arguments):
        return compose(self.host, arguments)

    def healthy(self):
        return are_healthy(self.host, SERVICES)

    def secrets(self):
        return secrets_of(self.host)


@pytest.fixture(scope="module")
def server(hosts, tmp_path_factory):
    """A bare machine; its images are handed over, as on a site without internet."""
    folder = tmp_path_factory.mktemp("server")
    images = save_images(folder)
    host = boot_machine(hosts, "cloud-vm")
    inventory = folder / "server.ini"
    settings = (
        f'{{"PUBLIC_HOST": "robots.test", "JOIN_POLICY": "token-only", "TAG": "{image_tag()}"}}'
    )
    inventory.write_text(
        f"[robotether_server]\n{host.inventory_line(robotether_server_settings=settings)}\n"
        f"[robotether_server:vars]\nrobotether_server_images={images}\n"
    )
    yield Server(host, Controller("server.yml", inventory, clone_sources(folder)))
    images.unlink()


def test_bare_machine_becomes_the_server_once(server):
    """--check works before; the first run ends healthy and prints its fingerprint; the second changes nothing."""
    before = server.host.run("ls /opt /etc /etc/systemd/system")
    server.controller.play("--check")
    assert server.host.run("ls /opt /etc /etc/systemd/system") == before

    changed, said = server.controller.play()
    assert changed > 0
    assert "https://robots.test/" in said
    assert re.search(r"SHA-256 ([0-9A-F]{2}:){31}", said)
    assert server.healthy()
    assert "admin" in server.compose("exec -T web robotether user list")
    assert "token-only" in server.compose("exec -T web printenv JOIN_POLICY")
    password = server.host.run(f"cat {FOLDER}/compose/secrets/admin_password")
    assert password not in said

    secrets = server.secrets()
    changed, said = server.controller.play()
    assert changed == 0, said
    changed, said = server.controller.play("--check")
    assert changed == 0, said
    assert server.secrets() == secrets


def test_firewall_admits_what_it_should(server):
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


def test_upgrade_makes_a_backup_first(server):
    """Another version leaves a backup whose records can be restored, beside that of an attempt before it."""
    server.compose("exec -T web robotether robot add kept --mac 00:1b:44:11:3a:b7")
    secrets = server.secrets()
    folder = "/var/backups/robotether"
    for _ in range(2):
        server.host.run(f"echo 'older built' > {FOLDER}/compose/.deployed")
        server.controller.play("-e", "robotether_server_dumps_kept=1")
    assert server.secrets() == secrets
    [_, backup] = server.host.run(f"ls {folder}").split()
    server.compose("exec -T web robotether robot remove kept --yes")
    # As docs/howto/server.md says, into a new volume, whose accounts have no rights yet.
    server.compose("down")
    server.host.run("docker volume rm robotether_mysql")
    server.host.run(f"cd {FOLDER} && tools/restore --database {folder}/{backup}")
    server.host.run(f"cd {FOLDER} && tools/up --no-build")
    assert "kept" in server.compose("exec -T web robotether robot list")


def test_timer_makes_a_backup(server):
    """It waits for the night; what it starts works as systemd starts it."""
    assert server.host.run("systemctl is-enabled robotether-backup.timer").strip() == "enabled"
    assert "robotether-backup.service" in server.host.run("systemctl list-timers --no-pager")
    server.host.run("systemctl start robotether-backup.service")
    records = server.compose("exec -T web ls /var/lib/robotether/backups").split()
    assert records == ["disk", "made"]


def test_stack_and_firewall_come_back_at_boot(server):
    server.host.reboot()
    server.host.wait_booted()
    server.host.wait("the stack healthy", server.healthy, seconds=120)
    assert "robotether" in server.host.run("nft list tables")


def _answers(url):
    return run_command("curl", "-sk", "-m", "4", "-o", "/dev/null", url).returncode == 0
