"""The version of the agent that the playbooks install on a robot, here on this machine."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

ROLES = Path(__file__).resolve().parents[3] / "ansible/roles"
PLAY = """
- hosts: localhost
  gather_facts: false
  tasks:
    - ansible.builtin.include_role: {name: robotether_agent, tasks_from: install_version}
"""
# In place of the agent's own installer, which needs a package index.
INSTALLER = """
import sys
from pathlib import Path
command = Path(sys.argv[1], "bin/robotether-agent")
command.parent.mkdir()
command.write_text("new")
"""


def test_version_that_does_not_start_is_installed_anew(tmp_path: Path) -> None:
    """After an upgrade of Debian it is there, and was made for another Python."""
    (tmp_path / "play.yml").write_text(PLAY)
    (tmp_path / "requirements.txt").write_text("")
    wheel = tmp_path / "robotether_agent-1-py3-none-any.whl"
    with ZipFile(wheel, "w") as archive:
        archive.writestr("robotether_agent/__init__.py", "")
        archive.writestr("robotether_agent/install.py", INSTALLER)
    version = tmp_path / "opt/versions/1-a"
    (version / "bin").mkdir(parents=True)
    (version / "bin/robotether-agent").write_text("old")
    (version / "lib").mkdir()
    variables = {
        "robotether_agent_root": str(tmp_path / "opt"),
        "robotether_agent_venv": str(version),
        "robotether_wheel_path": str(wheel),
        "ansible_python_interpreter": sys.executable,
    }
    ansible = Path(sys.executable).with_name("ansible-playbook")
    done = subprocess.run(
        [
            ansible,
            "--connection",
            "local",
            "--inventory",
            "localhost,",
            "--extra-vars",
            json.dumps(variables),
            "play.yml",
        ],
        cwd=tmp_path,
        env={**os.environ, "ANSIBLE_ROLES_PATH": str(ROLES), "ANSIBLE_NOCOLOR": "1"},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    assert (version / "bin/robotether-agent").read_text() == "new"
    assert not (version / "lib").exists()
