"""ansible/site.yml, run for real: three bare Debians with systemd become the cells of one site."""

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
SERVICES = {"nginx", "recorder", "relay", "sshd", "web"}
NAMES = ("cell-a", "cell-b", "cell-c")


@dataclass
class Site:
    """The machines, of which the first has the database, and the admin's own."""

    machines: list[RobotHost]
    controller: Controller

    def healthy(self):
        first, *others = self.machines
        return are_healthy(first, SERVICES | {"mysql"}) and all(
            are_healthy(item, SERVICES) for item in others
        )

    def alive(self):
        return self.sql("SELECT name FROM cells WHERE heartbeat_at > NOW() - INTERVAL 5 SECOND")

    def sql(self, query):
        asked = f'mariadb --batch --skip-column-names robotether -e "{query}"'
        return set(compose(self.machines[0], f"exec -T --user root mysql {asked}").split())


@pytest.fixture(scope="module")
def site(hosts, tmp_path_factory):
    """Bare machines; their images are handed over, as on a site without internet."""
    folder = tmp_path_factory.mktemp("site")
    images = save_images(folder)
    machines = [boot_machine(hosts, name) for name in NAMES]
    inventory = folder / "site.ini"
    lines = [
        machine.inventory_line(robotether_cell_public_host=f"{machine.name}.test")
        for machine in machines
    ]
    inventory.write_text(
        "[robotether_cells]\n" + "\n".join(lines) + "\n[robotether_cells:vars]\n"
        f"robotether_server_images={images}\n"
        f'robotether_server_settings={{"TAG": "{image_tag()}"}}\n'
    )
    yield Site(machines, Controller("site.yml", inventory, clone_sources(folder)))
    images.unlink()


def test_bare_machines_become_one_site_once(site):
    """--check works before; a second run changes nothing; what people and robots see is the same everywhere."""
    before = [machine.run("ls /opt /etc") for machine in site.machines]
    site.controller.play("--check")
    assert [machine.run("ls /opt /etc") for machine in site.machines] == before

    changed, said = site.controller.play()
    assert changed > 0
    assert site.healthy()
    first, *others = site.machines
    first.wait("all cells alive", lambda: site.alive() == set(NAMES))
    compose(first, "exec -T web robotether user add ann")
    key = "exec -T sshd cat /etc/ssh/public/ssh_host_ed25519_key.pub"
    for other in others:
        assert "ann" in compose(other, "exec -T web robotether user list")
        assert compose(other, key) == compose(first, key)
    secret = others[0].run(f"cat {FOLDER}/compose/secrets/ticket_key")
    assert secret not in said

    secrets = [secrets_of(machine) for machine in site.machines]
    changed, said = site.controller.play()
    assert changed == 0, said
    changed, said = site.controller.play("--check")
    assert changed == 0, said
    assert [secrets_of(machine) for machine in site.machines] == secrets


def test_database_is_for_the_cells_alone(site):
    """The firewall of its machine drops what comes from elsewhere, although Docker publishes it."""
    first, other, _ = site.machines
    first.container.reload()
    (network,) = first.container.attrs["NetworkSettings"]["Networks"].values()
    address = network["IPAddress"]
    for port in (3306, 8444):
        connect = f"timeout 4 bash -c '</dev/tcp/{address}/{port}'"
        assert other.succeeds(connect)
        assert run_command("bash", "-c", connect).returncode != 0


def test_upgrade_takes_one_cell_after_the_other(site):
    for machine in site.machines:
        machine.run(f"echo 'older built' > {FOLDER}/compose/.deployed")
    changed, _ = site.controller.play()
    assert changed > 0
    assert site.healthy()
    site.machines[0].wait("all cells alive", lambda: site.alive() == set(NAMES))
    for kind in ("cell_drained", "cell_resumed"):
        cells = f"SELECT JSON_VALUE(details, '$.cell') FROM audit_events WHERE kind = '{kind}'"
        assert site.sql(cells) == set(NAMES)
    assert site.sql("SELECT name FROM cells WHERE draining") == set()
    # Of the upgrade there is a dump, where the database is.
    assert "robotether-" in site.machines[0].run("ls /var/backups/robotether")
