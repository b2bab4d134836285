"""enroll.yml takes robots from SSH and Python to drivable, once, and retire.yml undoes it on server and robot."""

import asyncio
import io
import re
import tarfile
import time
from dataclasses import dataclass
from pathlib import Path

import pytest
from playbooks import WITH_VIDEO, Played
from programs import Program, drive_forward
from robot_hosts import WHEELHOUSE, RobotHost


@dataclass
class Enrolled:
    """One robot enrolled with an admin's token and pip, and what each run said."""

    robot: RobotHost
    # All files that it had before.
    before: set[str]
    first: Played
    second: Played


@pytest.fixture(scope="module")
def enrolled(site, hosts):
    robot = hosts.boot("turtle")
    before = robot.footprint()
    first = site.play_well("enroll.yml", robot, robotether_agent_environment=WITH_VIDEO)
    second = site.play_well("enroll.yml", robot, verbosity=3)
    return Enrolled(robot, before, first, second)


def test_a_second_run_changes_nothing(enrolled):
    """Each run ends with a message that went through the server to rosbridge and back."""
    assert enrolled.first.changed["turtle"] > 0
    assert re.search(r"a message went to its rosbridge and back in [0-9.]+ ms", enrolled.first.text)
    assert "WARNING: rosbridge" not in enrolled.first.text
    assert enrolled.second.changed["turtle"] == 0


async def test_it_encodes_video_and_a_twist_moves_it(enrolled, site):
    """PyAV has come with the agent, and works under the Python of this Debian."""
    said = enrolled.robot.run("robotether-agent doctor", check=False)
    assert "libx264 encodes H.264" in said
    assert await drive_forward(Program(site.stack, site.token), "turtle") >= 0.5


def test_the_row_has_mac_key_and_name(enrolled, site):
    """The server knows the robot by eth0's MAC, active, with the key whose private half is on the robot only."""
    [[mac, state, fingerprint]] = site.stack.sql(
        "SELECT mac, state, fingerprint FROM robots WHERE name = 'turtle'"
    )
    assert (mac, state) == (enrolled.robot.mac, "active")
    shown = enrolled.robot.run("ssh-keygen -lf /var/lib/robotether-agent/id_ed25519.pub")
    assert fingerprint in shown
    mode = enrolled.robot.run("stat -c '%a %U' /var/lib/robotether-agent/id_ed25519")
    assert mode.split() == ["600", "robotether"]


def test_the_token_is_nowhere(enrolled, site):
    assert site.token not in enrolled.first.printed + enrolled.second.printed
    found = enrolled.robot.run(
        f"grep -rlF {site.token} /etc /opt /var /home /root /tmp /run 2>/dev/null", check=False
    )
    assert found == ""


async def test_power_off_and_on(enrolled, site):
    await asyncio.to_thread(enrolled.robot.switch_off)
    started = time.monotonic()
    await asyncio.to_thread(enrolled.robot.switch_on)
    while not await _answers(site, "turtle"):
        assert time.monotonic() - started < 60, enrolled.robot.run("journalctl -n 50 --no-pager")
        await asyncio.sleep(0.05)


async def _answers(site, robot):
    try:
        async with asyncio.timeout(5), Program(site.stack, site.token).connect(robot) as socket:
            await socket.send_json({"op": "subscribe", "topic": "/pose", "type": "turtlesim/Pose"})
            return "pose" in await socket.receive_str()
    except (OSError, TimeoutError, TypeError):
        return False


def test_no_answer_retires_nothing(enrolled, site):
    played = site.play("retire.yml", enrolled.robot)
    assert played.code != 0
    played.must_say("nothing changed: the answer was not yes")
    assert site.stack.online("turtle")


def test_retired_leaves_nothing(enrolled, site):
    """After it, also under another name on the server, files, users, units and row are as before the enrolment."""
    site.stack.admin.ask("PATCH", "/robots/turtle", {"name": "renamed"})
    site.play_well("retire.yml", enrolled.robot, retire_confirm="true")
    assert enrolled.robot.footprint() ^ enrolled.before == set()
    assert not enrolled.robot.succeeds("pgrep -f robotether-agent")
    assert not enrolled.robot.succeeds("systemctl cat robotether-agent")
    rows = site.stack.sql(f"SELECT name FROM robots WHERE mac = '{enrolled.robot.mac}'")
    assert rows == []


@pytest.mark.release
def test_join_token_and_wheelhouse(site, hosts, tmp_path):
    """A join token with one use and a folder of wheels are enough, on a robot whose pip reaches no index."""
    rover = hosts.boot("rover")
    packed, _ = rover.container.get_archive(WHEELHOUSE)
    with tarfile.open(fileobj=io.BytesIO(b"".join(packed))) as archive:
        archive.extractall(tmp_path, filter="data")
    token = site.join_token(uses=1)
    variables = {
        "agent_wheelhouse": str(tmp_path / Path(WHEELHOUSE).name),
        "robotether_agent_environment": {"PIP_INDEX_URL": "https://127.0.0.1:1/"},
    }
    first = site.play_well("enroll.yml", rover, token=token, **variables)
    first.must_say("its tunnel is up")
    second = site.play_well("enroll.yml", rover, token=token, **variables)
    assert second.changed["rover"] == 0
    rover.wait("online", lambda: site.stack.online("rover"))


@pytest.mark.release
def test_a_check_changes_nothing(site, hosts):
    robot = hosts.boot("looked-at")
    before = robot.footprint()
    check = site.play_well("enroll.yml", robot, check=True)
    assert check.changed["looked-at"] > 0
    check.must_say("would create the robot's key")
    assert robot.footprint() ^ before == set()
    assert site.stack.sql("SELECT * FROM robots WHERE name = 'looked-at'") == []


@pytest.mark.release
def test_an_announced_robot_is_taken(site, hosts):
    """A row that an admin made before gets the robot's key; the run tells what of the robot should be otherwise."""
    scout = hosts.boot("scout")
    scout.ros_listens_on("0.0.0.0")
    site.stack.robotether("robot", "add", "scout", "--mac", scout.mac)
    played = site.play_well("enroll.yml", scout, robotether_tuning_bbr="true")
    scout.wait("online", lambda: site.stack.online("scout"))
    played.must_say("scout keeps its kernel settings: they are read-only here")
    played.must_say("WARNING: rosbridge answers at ")


@pytest.mark.release
def test_kernel_settings_come_and_go(site, hosts):
    """A setting is in force at once and after the next boot, a second run changes nothing, and it is removed."""
    tuned = hosts.boot("tuned")
    # A container's is read-only; this setting is the container's own.
    tuned.run("mount -o remount,rw,bind /proc/sys")
    setting, file = "/proc/sys/net/ipv4/tcp_notsent_lowat", "/etc/sysctl.d/60-robotether.conf"
    wanted = {"robotether_tuning_notsent_lowat": 16384}
    site.play_well("enroll.yml", tuned, **wanted)
    assert tuned.run(f"cat {setting}").strip() == "16384"
    assert tuned.run(f"cat {file}").split() == ["net.ipv4.tcp_notsent_lowat=16384"]
    assert site.play_well("enroll.yml", tuned, **wanted).changed["tuned"] == 0
    site.play_well("enroll.yml", tuned)
    assert not tuned.succeeds(f"test -e {file}")
