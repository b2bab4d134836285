"""agent_runtime=docker: the agent in a container on the robot, with the robot's network, and away again."""

from __future__ import annotations

import pytest
from docker.types import Mount
from playbooks import Site
from robot_hosts import SYSTEMD, RobotHost, RobotHosts

# An image is built, carried over and loaded by a Docker inside the host.
pytestmark = pytest.mark.release
# Its usual bridge would have the very address at which this machine's server is.
SETTINGS = b'{"bridge": "none"}'
# A container's /proc/sys is read-only, and Docker inside it sets its networks up there.
DROP_IN = b"[Service]\nExecStartPre=/bin/mount -o remount,rw,bind /proc/sys\n"


@pytest.fixture(scope="module")
def robot(hosts: RobotHosts) -> RobotHost:
    """A robot with a Docker of its own."""
    host = hosts.boot(
        "boxed",
        # overlay2 needs another file system than the container's own; runc needs to look into what it started.
        mounts=[Mount("/var/lib/docker", None, type="volume")],
        cap_add=[*SYSTEMD["cap_add"], "SYS_PTRACE"],
    )
    host.put(SETTINGS, "/etc/docker/daemon.json")
    host.put(DROP_IN, "/etc/systemd/system/docker.service.d/container.conf")
    # Packages of the distribution stay on a robot that is retired.
    packages = "docker.io python3-requests"
    host.run(f"apt-get update -qq && apt-get install -y -qq --no-install-recommends {packages}")
    host.wait("Docker answers", lambda: host.succeeds("docker info"), 60)
    return host


def test_enrolled_rebooted_retired(site: Site, robot: RobotHost) -> None:
    """It is enrolled, a second run changes nothing, it comes back after a power cut, and retiring leaves nothing."""
    before = robot.footprint()
    docker = {"agent_runtime": "docker"}
    first = site.play_well("enroll.yml", robot, **docker)
    first.must_say("a message went to its rosbridge and back")
    assert "connected" in robot.run("robotether-agent status")
    second = site.play_well("enroll.yml", robot, **docker)
    assert second.recaps["boxed"].changed == 0

    robot.switch_off()
    site.stack.wait("boxed offline", lambda: not site.stack.online("boxed"))
    robot.switch_on()
    robot.wait("boxed online", lambda: site.stack.online("boxed"), 120)
    # The agent does not wait for the sshd that the playbook needs.
    robot.wait("SSH answers", robot.greets)

    site.play_well("retire.yml", robot, **docker, retire_confirm=True)
    assert robot.footprint() ^ before == set()
    assert robot.run("docker ps -aq; docker image ls -q") == ""
