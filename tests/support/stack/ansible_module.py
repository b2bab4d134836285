"""One module of the collection, run once on this machine by Ansible itself."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

ANSIBLE = Path(__file__).resolve().parents[3] / "ansible"
WAIT_S = 60


async def run_module(
    name: str, arguments: Mapping[str, object], *options: str, path: str = ""
) -> dict[str, Any]:
    """What it returned, and whether it `failed`; `path` is the PYTHONPATH."""
    process = await asyncio.create_subprocess_exec(
        Path(sys.executable).with_name("ansible"), "localhost", "--inventory", "localhost,",
        "--connection", "local", "--extra-vars", f"ansible_python_interpreter={sys.executable}",
        "--playbook-dir", str(ANSIBLE), "--module-name", f"robotether.robotether.{name}",
        "--args", json.dumps(arguments), *options,
        env={**os.environ, "ANSIBLE_NOCOLOR": "1", "PYTHONPATH": path},
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    printed, errors = await asyncio.wait_for(process.communicate(), WAIT_S)
    # After the machine's name and what became of it.
    _, arrow, result = printed.decode().partition("=> ")
    assert arrow, f"{printed.decode()}\n{errors.decode()}"
    found: dict[str, Any] = json.loads(result)
    return {"failed": process.returncode != 0, **found}
