"""upgrade.yml brings another agent to robots, one first, and stops at the first that goes back to its old one."""

import shutil

import pytest
from playbooks import build_wheel
from robot_hosts import ROOT

# Each version is built and installed on hosts of its own.
pytestmark = pytest.mark.release
# A version that starts and dies, as one with a defect does.
BROKEN = '\n\ndef run(settings, environ):\n    raise RuntimeError("broken on purpose")\n'


@pytest.fixture(scope="module")
def robots(site, hosts):
    booted = hosts.boot_all("first", "second")
    site.play_well("enroll.yml", *booted)
    return booted


def _other_version(folder, version, appended_to_run=""):
    sources = folder / "changed"
    shutil.copytree(ROOT / "agent", sources)
    (sources / "robotether_agent" / "__init__.py").write_text(
        f'"""A version for a test."""\n\n__version__ = "{version}"\n'
    )
    run = sources / "robotether_agent" / "cli.py"
    run.write_text(run.read_text() + appended_to_run)
    return build_wheel(sources, folder)


def _version(robot):
    return robot.run("robotether-agent --version").split()[-1]


def test_broken_version_stops_at_the_first(site, robots, tmp_path):
    wheel = _other_version(tmp_path, "0.9.0", BROKEN)
    before = [_version(robot) for robot in robots]
    played = site.play(
        "upgrade.yml",
        *robots,
        robotether_wheel_file=str(wheel),
        robotether_agent_switch_timeout=8,
    )
    assert played.code != 0
    played.must_say("first did not come up with version 0.9.0")
    assert "second" not in played.changed
    assert [_version(robot) for robot in robots] == before
    assert not robots[1].succeeds("ls -d /opt/robotether-agent/versions/0.9.0*")
    for robot in robots:
        robot.wait(f"{robot.name} online", lambda name=robot.name: site.stack.online(name))


def test_good_version_reaches_all(site, robots, tmp_path):
    wheel = str(_other_version(tmp_path, "0.9.1"))
    for playbook in ("enroll.yml", "upgrade.yml"):
        checked = site.play(playbook, *robots, check=True, robotether_wheel_file=wheel)
        assert checked.code == 0, checked.printed
        assert all(checked.changed.values())
    assert "0.9.1" not in [_version(robot) for robot in robots]
    site.play_well("upgrade.yml", *robots, robotether_wheel_file=wheel)
    assert [_version(robot) for robot in robots] == ["0.9.1", "0.9.1"]
    again = site.play_well("upgrade.yml", *robots, robotether_wheel_file=wheel)
    assert set(again.changed.values()) == {0}


def test_no_agent_to_upgrade(site, hosts):
    bare = hosts.boot("bare")
    before = bare.footprint()
    played = site.play("upgrade.yml", bare)
    played.must_say("no agent is installed there; enrol it first")
    assert bare.footprint() == before


def test_through_its_own_tunnel(site, robots, tmp_path):
    """A robot that is reached through the tunnel of the agent which is replaced is upgraded all the same."""
    robot = robots[0]
    port = _open_shell(site, robot)
    robot.wait(
        "shell tunnel",
        lambda: "shell tunnel  open" in robot.run("robotether-agent status", check=False),
    )
    known = "-o StrictHostKeyChecking=no -o UserKnownHostsFile=/dev/null"
    jump = f"ssh -i {robot.key} {known} -p {site.stack.ssh_port} -W 127.0.0.1:{port} jump@127.0.0.1"
    site.play_well(
        "upgrade.yml",
        robot,
        robotether_wheel_file=str(_other_version(tmp_path, "0.9.2")),
        ansible_port=str(port),
        ansible_ssh_common_args=f"{known} -o 'ProxyCommand={jump}'",
    )
    assert _version(robot) == "0.9.2"


def _open_shell(site, robot):
    """Let the admin reach the robot's SSH through the server; the port there."""
    bearer = {"Authorization": f"Bearer {site.token}"}
    key = {"name": "upgrade", "public_key": robot.key.with_suffix(".pub").read_text().strip()}
    status, answer = site.stack.request("POST", "/api/v1/me/ssh-keys", key, bearer)
    assert status == 201, answer
    status, answer = site.stack.request(
        "PATCH", f"/api/v1/robots/{robot.name}", {"shell": True}, bearer
    )
    assert status == 200, answer
    return int(answer["shell_port"])
