"""The agent's Debian package, as the stack serves it, on Debian hosts that boot systemd and reach no package index."""

import re
from dataclasses import dataclass

import pytest
from commands import output_of_command
from playbooks import Site, invite
from programs import Program, drive_forward
from robot_hosts import (
    IMAGE,
    NEWER_IMAGE,
    ROOT,
    VIDEO_WHEELHOUSE,
    RobotHost,
    newer_systemd_boots,
)

INSTALL = "DEBIAN_FRONTEND=noninteractive apt-get install -y --reinstall /root/agent.deb"
# A container's interface is virtual, so the agent would find none by itself.
SETTINGS = """\
server = "{server}"
tls_fingerprint = "{fingerprint}"
token_file = "/etc/robotether/token"
interface = "eth0"
name = "{name}"
"""
DPKGS_OWN = re.compile(r"/var/(lib/(dpkg|apt)|cache)/")
OLDER = "0.0.9-aaaaaaaaaaaa"


@dataclass
class Packaged:
    """A host with the package's file, which has not been installed yet."""

    host: RobotHost
    site: Site
    name: str

    def install(self):
        return self.host.run(INSTALL)

    def invite(self):
        return invite(self.site.stack, self.site.token, self.name)

    def is_running(self):
        return self.host.succeeds("systemctl is-active robotether-agent")

    def footprint(self):
        return {line for line in self.host.footprint() if not DPKGS_OWN.match(line)}

    async def drives(self):
        self.site.stack.wait(f"{self.name} online", self.is_online, "relay", "sshd")
        return await drive_forward(Program(self.site.stack, self.site.token), self.name) >= 0.5

    def is_online(self):
        return self.site.stack.online(self.name)


def boot(site, hosts, name, suite, **options):
    if suite == "trixie":
        output_of_command(ROOT / "tools" / "ensure_robot_host_image", suite, limit_s=600)
    host = hosts.boot(name, image=NEWER_IMAGE if suite == "trixie" else IMAGE, **options)
    host.put(b"[global]\nindex-url = http://127.0.0.1:1/\n", "/etc/pip.conf")
    host.run("rm -r /opt/wheelhouse")
    host.run(f"curl -fsSk -o /root/agent.deb https://cloud:{site.stack.https_port}/agent.deb")
    return Packaged(host, site, name)


BOOTS = pytest.mark.skipif(
    not newer_systemd_boots(), reason="systemd 257 does not boot in a container on cgroup v1"
)


@pytest.fixture(params=["bookworm", pytest.param("trixie", marks=[pytest.mark.release, BOOTS])])
def robot(request, site, hosts):
    """A host of Debian 12 or 13 that never was a robot."""
    made = boot(site, hosts, f"boxed-{request.param}", request.param)
    yield made
    hosts.remove(made.host)


async def test_settings_written_before_make_a_robot_and_purging_leaves_nothing(robot):
    host, site = robot.host, robot.site
    before = robot.footprint()
    # As root leaves them: the agent's user is not there yet.
    settings = SETTINGS.format(server=site.server, fingerprint=site.fingerprint, name=robot.name)
    host.put(settings.encode(), "/etc/robotether/agent.toml")
    host.put(f"{robot.invite()['token']}\n".encode(), "/etc/robotether/token", 0o600)
    robot.install()
    assert await robot.drives()

    # A package over another version switches as an upgrade does, which would roll back.
    host.run(
        f"cd /opt/robotether-agent/versions && was=$(ls) && mv $was {OLDER}"
        f' && sed -i "s#/versions/$was/#/versions/{OLDER}/#" {OLDER}/bin/*'
        f" && ln -sfn versions/{OLDER} ../current && systemctl restart robotether-agent"
    )
    site.stack.wait("the older version online", robot.is_online, "relay")
    assert f"switching from {OLDER} to 0.1.0-" in robot.install()
    assert '"result": "done"' in host.run("cat /opt/robotether-agent/last-switch.json")

    host.run("apt-get remove -y robotether-agent")
    assert not robot.is_running()
    assert not host.succeeds("ls /opt/robotether-agent || systemctl cat robotether-agent")
    host.run("apt-get purge -y robotether-agent")
    assert robot.footprint() ^ before == set()


@pytest.mark.release
async def test_package_without_settings_waits_for_the_line(site, hosts):
    """It does not start by itself; the install line finds the agent in place and needs the server alone."""
    robot = boot(site, hosts, "boxed", "bookworm")
    said = robot.install()
    assert "has no server yet" in said
    assert not robot.is_running()
    assert not robot.host.succeeds("systemctl is-enabled robotether-agent")
    # The package has no PyAV, and the robot no index.
    assert "Without it cameras send JPEG" in said
    robot.host.run(f"robotether-agent install-video --wheelhouse {VIDEO_WHEELHOUSE}")
    line = f"{robot.invite()['command']} --interface eth0 --name {robot.name}"
    assert "installing the agent" not in robot.host.run(line)
    assert await robot.drives()
    # What a person disabled stays so.
    robot.host.run("systemctl disable --now robotether-agent")
    robot.install()
    assert not robot.is_running()
    assert not robot.host.succeeds("systemctl is-enabled robotether-agent")


@pytest.mark.release
def test_package_goes_into_an_image_that_does_not_boot(site, hosts):
    """An image's builder gets it enabled and not started, also with the next release's Python and systemd."""
    robot = boot(site, hosts, "unbooted", "trixie", command=["sleep", "infinity"])
    before = robot.footprint()
    settings = SETTINGS.format(server=site.server, fingerprint=site.fingerprint, name="cloned")
    robot.host.put(settings.encode(), "/etc/robotether/agent.toml")
    robot.install()
    assert robot.host.succeeds("systemctl is-enabled robotether-agent")
    assert robot.host.succeeds("robotether-agent --version")
    robot.host.run("apt-get purge -y robotether-agent")
    assert robot.footprint() ^ before == set()
