"""What the playbooks install and write on a robot, here on this machine."""

import json
import os
from zipfile import ZipFile

import pytest
from ansible_module import of_role, play
from commands import write_programs

# In place of the agent's own installer, which needs a package index.
INSTALLER = """
import sys
from pathlib import Path
command = Path(sys.argv[1], "bin/robotether-agent")
command.parent.mkdir()
command.write_text("new")
"""


def test_version_that_does_not_start_is_installed_anew(tmp_path):
    """After an upgrade of Debian it is there, and was made for another Python."""
    (tmp_path / "requirements.txt").write_text("")
    wheel = tmp_path / "robotether_agent-1-py3-none-any.whl"
    with ZipFile(wheel, "w") as archive:
        archive.writestr("robotether_agent/__init__.py", "")
        archive.writestr("robotether_agent/install.py", INSTALLER)
    version = tmp_path / "opt/versions/1-a"
    (version / "bin").mkdir(parents=True)
    (version / "bin/robotether-agent").write_text("old")
    (version / "lib").mkdir()
    done = play(
        tmp_path,
        [of_role("robotether_agent", "install_version")],
        robotether_agent_root=str(tmp_path / "opt"),
        robotether_agent_venv=str(version),
        robotether_wheel_path=str(wheel),
    )
    assert done.returncode == 0, done.stdout
    assert (version / "bin/robotether-agent").read_text() == "new"
    assert not (version / "lib").exists()


def test_robot_without_what_encodes_video_goes_on(tmp_path):
    """The robot sends JPEG then, and the run says so; no copy of a wheel stays."""
    (tmp_path / "wheels").mkdir()
    for name in ("av-18.1.0-cp311-abi3-x.whl", "aiohttp-3.14.5-x.whl"):
        (tmp_path / "wheels" / name).touch()
    write_programs(tmp_path / "bin", {"robotether-agent": "echo $1: $(ls $3) >&2; exit 1"})
    done = play(
        tmp_path,
        [of_role("robotether_agent", "install_video")],
        robotether_agent_venv=str(tmp_path),
        robotether_agent_wheelhouse=str(tmp_path / "wheels"),
    )
    assert done.returncode == 0, done.stdout
    [warning] = [line for line in done.stdout.splitlines() if "WARNING" in line]
    assert "install-video: av-18.1.0-cp311-abi3-x.whl. localhost sends JPEG" in warning
    assert not (tmp_path / "packages").exists()


SWITCHES = {
    "good": ("2-b", "done"),
    "failed": ("2-b", "rolled_back"),
    "never-begun": ("1-a", "done"),
}


def test_switch_is_judged_by_its_own_result(tmp_path):
    """One that could not begin, as on a full disk, leaves the result of the last."""
    write_programs(tmp_path, {"systemd-run": "exit 0", "systemctl": "echo inactive"})
    tasks = []
    for name, (wanted, result) in SWITCHES.items():
        (tmp_path / name).mkdir()
        report = {"result": result, "wanted": wanted, "detail": "it was not connected"}
        (tmp_path / name / "last-switch.json").write_text(json.dumps(report))
        switch = of_role("robotether_agent", "switch")
        switch["vars"] = {"robotether_agent_root": str(tmp_path / name)}
        said = "{{ ansible_failed_result.msg | default(ansible_failed_result.results) }}"
        failed = {"ansible.builtin.debug": {"msg": f"{name} failed: {said}"}}
        tasks.append({"block": [switch], "rescue": [failed]})
    said = play(tmp_path, tasks, robotether_wheel_version="2-b").stdout
    assert "good failed" not in said
    why = "localhost did not come up with version 2-b"
    assert f"failed failed: {why}: it was not connected" in said, said
    assert f"never-begun failed: {why}: the switch has left no result" in said


@pytest.mark.skipif(os.geteuid() != 0, reason="the settings are root's")
def test_settings_with_a_password_are_kept_from_others(tmp_path):
    camera, config = "rear=http://ann:s3cret@10.0.0.7/video", tmp_path / "etc/agent.toml"
    done = play(
        tmp_path,
        [of_role("robotether_agent", "configure")],
        robotether_agent_config=str(config),
        robotether_agent_settings={"cameras": [camera]},
        robotether_agent_server="robots.example",
        robotether_agent_state=str(tmp_path / "state"),
        robotether_agent_owner="root",
        robotether_agent_validate={"venv": "/bin/true %s"},
        robotether_agent_was_installed=False,
    )
    assert done.returncode == 0, done.stdout
    assert f'cameras = ["{camera}"]' in config.read_text()
    assert config.stat().st_mode & 0o777 == 0o640
