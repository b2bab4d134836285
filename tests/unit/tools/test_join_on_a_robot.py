"""What agent/join.sh changes on a robot that has an agent; tests/ansible/test_join_line.py runs it whole."""

from pathlib import Path

import pytest
import tomllib
from commands import output_of_command, path_with, write_programs
from robotether_agent.upgrade import PENDING_NAME

SCRIPT = Path(__file__).resolve().parents[3] / "agent/join.sh"
# In place of what would change this machine.
DOUBLES = """
install() { :; }
keep_copy() { :; }
on_failure() { :; }
protect() { :; }
systemctl() { echo "$@" >> "$work/systemctl"; [ "${2-}" != is-active ]; }
"""


class Robot:
    """A robot whose agent is connected to old.example."""

    def __init__(self, place):
        self.place = place
        self.settings = place / "agent.toml"
        self.settings.write_text('server = "old.example"\nlog_level = "debug"\n')
        (place / "new").mkdir()
        (place / "bin").mkdir()
        (place / "bin/systemd-run").symlink_to("/bin/true")
        (place / "steps.sh").write_text(SCRIPT.read_text().removesuffix('main "$@"\n'))

    def run(self, step, *options):
        """Run one step of the script as its main would, and return what it says."""
        places = f"CONFIG={self.settings} TOKEN={self.place}/token AGENT=true work={self.place}/new"
        words = f"set -eu; . {self.place}/steps.sh; {DOUBLES} {places}; did= first= changed="
        words += f'; read_options "$@"; check_options; {step}'
        environ = path_with(self.place / "bin")
        return output_of_command("sh", "-c", words, "join.sh", *options, env=environ)

    def new_settings(self, *options):
        self.run("ensure_config", *options)
        return tomllib.loads((self.place / "new/agent.toml").read_text())


@pytest.fixture
def robot(tmp_path):
    return Robot(tmp_path)


def test_line_of_another_server_brings_its_token(robot):
    """Connected is only what the robot leaves: the new server admits it by the token, with the name in the line."""
    options = ("--server", "new.example", "--token", "rj_x", "--name", "turtle")
    settings = robot.new_settings(*options)
    assert (settings["server"], settings["name"]) == ("new.example", "turtle")
    assert settings["token_file"] == f"{robot.place}/token"
    assert (robot.place / "token").read_text() == "rj_x\n"


def test_settings_whose_last_line_does_not_end(robot):
    """Some editors leave it so."""
    robot.settings.write_text('server = "old.example"\nlog_level = "debug"')
    settings = robot.new_settings("--rosbridge-url", "ws://127.0.0.1:9099")
    assert settings["log_level"] == "debug"
    assert settings["rosbridge_url"] == "ws://127.0.0.1:9099"


@pytest.mark.parametrize(
    ("line", "mode"),
    [
        ('cameras = ["rear=http://ann:s3cret@10.0.0.7/video"]', 0o640),
        ('  "rear=http://ann:s3cret@10.0.0.7/video",', 0o640),
        ('http_proxy = "http://ann:s3cret@proxy:3128"', 0o640),
        ('token = "rj_x"', 0o640),
        ('#http_proxy = "http://user:password@proxy.example.com:3128"', 0o644),
        ('cameras = ["rear=http://10.0.0.7/video?at=me@home"]', 0o644),
    ],
)
def test_settings_with_a_password_are_kept_from_others(robot, line, mode):
    """That holds where a person wrote it, and kept the file from others: the script writes it anew."""
    robot.settings.write_text(f'server = "old.example"\n{line}\n')
    robot.settings.chmod(0o644)
    robot.run(f"chgrp() {{ :; }}; . {robot.place}/steps.sh; protect {robot.settings}")
    assert robot.settings.stat().st_mode & 0o777 == mode


def test_settings_come_whole_and_with_their_mode(robot):
    """Nobody reads a password before the mode is set, and a power cut leaves the old ones or the new ones."""
    real = f"chgrp() {{ :; }}; . {robot.place}/steps.sh; install() {{ :; }}; on_failure() {{ :; }}"
    places = f"CONFIG={robot.settings}; TOKEN=/none; AGENT=true"
    moves = 'mv() { stat -c %a "$2"; command mv "$@"; }'
    options = ("--http-proxy", "http://ann:s3cret@proxy:3128")
    said = robot.run(f"{real}; {places}; {moves}; ensure_config", *options)
    assert said.splitlines()[-1] == "640"
    assert "s3cret" in robot.settings.read_text()
    assert robot.settings.stat().st_mode & 0o777 == 0o640


def upgrade(robot, words):
    """Let a robot with version 1 run version 2."""
    for name in ("1", "2"):
        (robot.place / "versions" / name).mkdir(parents=True)
    (robot.place / "current").symlink_to("versions/1")
    versions = f"ROOT={robot.place} venv={robot.place}/versions/2 version=2"
    return robot.run(f"{versions}; {words}; ensure_running")


def systemctl_calls(robot):
    return (robot.place / "new/systemctl").read_text().splitlines()


def test_upgrade_starts_an_agent_that_had_failed(robot):
    """`switch` leaves such a service alone, and the line says at its end that the agent runs."""
    assert "switching from 1 to 2" in upgrade(robot, "changed=1")
    assert systemctl_calls(robot)[-1] == "restart robotether-agent"


def test_upgrade_of_an_agent_that_does_not_start(robot):
    """The distribution has another Python now: the version in use cannot switch over."""
    assert "switching" not in upgrade(robot, "AGENT=false unit=new")
    assert (robot.place / "current").readlink() == Path("versions/2")
    assert systemctl_calls(robot)[-1] == "restart robotether-agent"


def test_uninstall_removes_an_upgrade_that_was_cut_short(robot):
    """Each boot would start it, and it would run a program that is gone."""
    units = robot.place / "units"
    (units / "multi-user.target.wants").mkdir(parents=True)
    (units / PENDING_NAME).touch()
    (units / "multi-user.target.wants" / PENDING_NAME).symlink_to(f"../{PENDING_NAME}")
    doubles = "id() { [ x$1 = x-u ] && echo 0; }; rm() { echo rm $*; }"
    places = f"UNIT={units}/robotether-agent.service LINK=/none ROOT=/none STATE=/none"
    said = robot.run(f"{doubles}; {places}; yes=1; uninstall")
    [removed] = [line.split() for line in said.splitlines() if line.startswith("rm ")]
    assert {f"{units}/{PENDING_NAME}", f"{units}/multi-user.target.wants/{PENDING_NAME}"} <= {
        *removed
    }
    assert systemctl_calls(robot)[0] == f"--quiet disable --now {PENDING_NAME}"


@pytest.mark.parametrize("status", ["installed", "half-configured"])
def test_uninstall_leaves_a_package_to_apt(robot, status):
    """Its files go with apt alone, and apt would install them anew with the next upgrade, or with the next package."""
    write_programs(robot.place / "bin", {"dpkg-query": f"echo {status}"})
    doubles = "id() { [ x$1 = x-u ] && echo 0; }; rm() { echo rm $*; }; fail() { echo $*; exit 0; }"
    said = robot.run(f"{doubles}; yes=1; uninstall")
    assert "apt purge robotether-agent" in said
    assert "rm " not in said
