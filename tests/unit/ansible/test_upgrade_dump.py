"""When server.yml dumps the database; tests/ansible/test_server.py makes and restores a dump."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

TASKS = Path(__file__).resolve().parents[3] / "ansible/roles/robotether_server/tasks/stack.yml"
HEALTHY = ["nginx=healthy", "mysql=healthy"]


@pytest.mark.parametrize(
    ("deployed", "healthy", "dumps"),
    [
        ("", [], False),
        ("", ["mysql=starting"], False),
        ("", HEALTHY, True),
        ("older built 0", HEALTHY, True),
        ("older built 0", [], True),
        ("now built 0", HEALTHY, False),
    ],
)
def test_stack_of_before_is_dumped(
    tmp_path: Path, deployed: str, healthy: list[str], dumps: bool
) -> None:
    """A bare machine has no database, and one that `make up` started has no record of its version."""
    decide = next(
        task
        for task in yaml.safe_load(TASKS.read_text())
        if task["name"] == "Decide whether to deploy"
    )
    tell = {"ansible.builtin.debug": {"msg": "dumps={{ robotether_server_is_upgrade | bool }}"}}
    play = {"hosts": "localhost", "gather_facts": False, "tasks": [decide, tell]}
    (tmp_path / "play.yml").write_text(json.dumps([play]))
    given = {
        "robotether_server_deployed": deployed,
        "robotether_server_code": "now built",
        "robotether_server_wanted": "now built 1",
        "robotether_server_services": ["mysql"],
        "robotether_server_healthy": {"stdout_lines": healthy},
    }
    words = [Path(sys.executable).with_name("ansible-playbook"), "play.yml"]
    words += ["-e", json.dumps(given)]
    environment = {**os.environ, "HOME": str(tmp_path), "ANSIBLE_LOCALHOST_WARNING": "no"}
    said = subprocess.run(
        words, cwd=tmp_path, env=environment, check=True, capture_output=True, text=True, timeout=60
    ).stdout
    assert re.findall(r"dumps=(\w+)", said) == [str(dumps)]
