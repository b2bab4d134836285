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
    for name, exit_code in (("works", 0), ("fails", 1)):
        (tmp_path / name).mkdir()
        lists = f"echo {name} $1: $(ls $3) >&2; exit {exit_code}"
        write_programs(tmp_path / name / "bin", {"robotether-agent": lists})
    role = of_role("robotether_agent", "install_video")
    done = play(
        tmp_path,
        [
            {**role, "vars": {"robotether_agent_venv": f"{tmp_path}/{name}"}}
            for name in ("works", "fails")
        ],
        robotether_agent_wheelhouse=str(tmp_path / "wheels"),
    )
    assert done.returncode == 0, done.stdout
    assert "changed=5 " in done.stdout
    warnings = [line for line in done.stdout.splitlines() if "WARNING" in line]
    assert len(warnings) == 1, done.stdout
    said = "fails install-video: av-18.1.0-cp311-abi3-x.whl. localhost sends JPEG"
    assert said in warnings[0]
    assert not list(tmp_path.glob("*/packages"))


@pytest.mark.parametrize(
    ("wanted", "result", "says"),
    [
        ("2-b", "done", "failed=0"),
        ("2-b", "rolled_back", "did not come up with version 2-b: it was not connected"),
        ("1-a", "done", "did not come up with version 2-b: the switch has left no result"),
    ],
)
def test_switch_is_judged_by_its_own_result(tmp_path, wanted, result, says):
    """One that could not begin, as on a full disk, leaves the result of the last."""
    report = {"result": result, "wanted": wanted, "detail": "it was not connected"}
    (tmp_path / "last-switch.json").write_text(json.dumps(report))
    write_programs(tmp_path, {"systemd-run": "exit 0", "systemctl": "echo inactive"})
    done = play(
        tmp_path,
        [of_role("robotether_agent", "switch")],
        robotether_agent_root=str(tmp_path),
        robotether_wheel_version="2-b",
    )
    assert says in done.stdout, done.stdout


@pytest.mark.skipif(os.geteuid() != 0, reason="the settings are root's")
def test_settings_with_a_password_are_kept_from_others(tmp_path):
    cameras = {
        "rear=http://10.0.0.7/video": 0o644,
        "rear=http://ann:s3cret@10.0.0.7/video": 0o640,
    }
    configs = [tmp_path / f"etc{number}/agent.toml" for number in range(len(cameras))]
    role = of_role("robotether_agent", "configure")
    tasks = [
        {
            **role,
            "vars": {
                "robotether_agent_config": str(config),
                "robotether_agent_settings": {"cameras": [camera]},
            },
        }
        for config, camera in zip(configs, cameras, strict=True)
    ]
    done = play(
        tmp_path,
        tasks,
        robotether_agent_server="robots.example",
        robotether_agent_state=str(tmp_path / "state"),
        robotether_agent_owner="root",
        robotether_agent_validate={"venv": "/bin/true %s"},
        robotether_agent_was_installed=False,
    )
    assert done.returncode == 0, done.stdout
    for config, (camera, mode) in zip(configs, cameras.items(), strict=True):
        assert f'cameras = ["{camera}"]' in config.read_text()
        assert config.stat().st_mode & 0o777 == mode
