"""One module of the collection, or some tasks, run once on this machine by Ansible itself."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

from commands import path_with, run_command

ANSIBLE = Path(__file__).resolve().parents[3] / "ansible"
WAIT_S = 60
# Time limit for a play of several tasks, on a machine that runs other tests.
PLAY_LIMIT_S = 300


def of_role(name: str, tasks: str) -> dict[str, Any]:
    return {"ansible.builtin.include_role": {"name": name, "tasks_from": tasks}}


def play(
    folder: Path, tasks: Sequence[Mapping[str, Any]], vars_file: Path | None = None, **given: Any
) -> CompletedProcess[str]:
    """Run tasks with the programs in `folder` before this machine's own, and without its user's settings."""
    whole = {"hosts": "localhost", "gather_facts": False, "tasks": tasks}
    files = {} if vars_file is None else {"vars_files": [str(vars_file)]}
    (folder / "play.yml").write_text(json.dumps([whole | files]))
    known = {"ansible_python_interpreter": sys.executable, **given}
    playbook = Path(sys.executable).with_name("ansible-playbook")
    words = (playbook, "play.yml", "-e", json.dumps(known))
    environ = {
        **os.environ,
        "HOME": str(folder),
        **path_with(folder),
        "ANSIBLE_ROLES_PATH": str(ANSIBLE / "roles"),
        "ANSIBLE_COLLECTIONS_PATH": str(ANSIBLE / "collections"),
        "ANSIBLE_NOCOLOR": "1",
        "ANSIBLE_LOCALHOST_WARNING": "no",
    }
    return run_command(*words, limit_s=PLAY_LIMIT_S, cwd=folder, env=environ)


async def run_module(name: str, arguments: Mapping[str, object]) -> dict[str, Any]:
    process = await asyncio.create_subprocess_exec(
        Path(sys.executable).with_name("ansible"), "localhost", "--inventory", "localhost,",
        "--connection", "local", "--extra-vars", f"ansible_python_interpreter={sys.executable}",
        "--playbook-dir", str(ANSIBLE), "--module-name", f"robotether.robotether.{name}",
        "--args", json.dumps(arguments),
        env={**os.environ, "ANSIBLE_NOCOLOR": "1", "PYTHONPATH": ""},
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    printed, errors = await asyncio.wait_for(process.communicate(), WAIT_S)
    # After the machine's name and what became of it.
    _, arrow, result = printed.decode().partition("=> ")
    assert arrow, f"{printed.decode()}\n{errors.decode()}"
    found: dict[str, Any] = json.loads(result)
    return {"failed": process.returncode != 0, **found}
