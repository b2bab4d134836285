"""tools/standby promote, with a program in the place of Docker; tests/images has two real databases."""

import os
import shutil
from pathlib import Path

from commands import run_command, write_programs

ROOT = Path(__file__).resolve().parents[3]
COMPOSE = """#!/bin/sh
echo "$*" >> calls
case "$*" in
  '--env DB_READ_ONLY') echo OFF ;;
  exec*) echo 'service "mysql" is not running' >&2; exit 1 ;;
esac
"""


def test_standby_that_cannot_be_asked_is_not_promoted(tmp_path):
    """It would take records while it still follows the other one."""
    (tmp_path / "tools").mkdir()
    for name in ("standby", "common.sh"):
        shutil.copy(ROOT / "tools" / name, tmp_path / "tools")
    write_programs(tmp_path / "tools", {"compose": COMPOSE})
    environ = {"PATH": os.environ["PATH"]}
    done = run_command("tools/standby", "promote", cwd=tmp_path, env=environ)
    assert done.returncode == 1
    assert "cannot promote this database" in done.stdout + done.stderr
    assert "up --detach" not in (tmp_path / "calls").read_text()
