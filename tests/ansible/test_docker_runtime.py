"""agent_runtime=docker: the agent in a container on the robot, with the robot's network, and away again."""

import pytest
from cloud_machines import boot_docker_host

# An image is built, carried over and loaded by a Docker inside the host.
pytestmark = pytest.mark.release
# Its usual bridge would have the very address at which this machine's server is.
SETTINGS = b'{"bridge": "none"}'


@pytest.fixture(scope="module")
def robot(hosts):
    host = boot_docker_host(hosts, "boxed")
    host.put(SETTINGS, "/etc/docker/daemon.json")
    # Packages of the distribution stay on a robot that is retired.
    packages = "docker.io python3-requests"
    host.run(f"apt-get update -qq && apt-get install -y -qq --no-install-recommends {packages}")
    host.wait("Docker answers", lambda: host.succeeds("docker info"), 60)
    return host


def test_enrolled_rebooted_retired(site, robot):
    before = robot.footprint()
    docker = {"agent_runtime": "docker"}
    first = site.play_well("enroll.yml", robot, **docker)
    first.must_say("a message went to its rosbridge and back")
    assert "connected" in robot.run("robotether-agent status")
    second = site.play_well("enroll.yml", robot, **docker)
    assert second.changed["boxed"] == 0

    robot.switch_off()
    site.stack.wait("boxed offline", lambda: not site.stack.online("boxed"))
    robot.switch_on()
    robot.wait("boxed online", lambda: site.stack.online("boxed"), 120)
    # The agent does not wait for the sshd that the playbook needs.
    robot.wait("SSH answers", robot.greets)

    site.play_well("retire.yml", robot, **docker, retire_confirm=True)
    assert robot.footprint() ^ before == set()
    assert robot.run("docker ps -aq; docker image ls -q") == ""
