"""tools/standby promote, with a program in the place of Docker; tests/images has two real databases."""

import os

import pytest
from commands import copy_tools, run_command, write_programs

COMPOSE = """#!/bin/sh
echo "$*" >> calls
case "$*" in
  '--env DB_READ_ONLY') echo OFF ;;
  ANSWER
esac
"""
AWAY = """exec*) echo 'service "mysql" is not running' >&2; exit 1 ;;"""
BREAKS_OFF = "*robotether_restoring*) exit 1 ;;"
HALF_RESTORED = "*robotether_restoring*) echo robotether_restoring ;;"


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (AWAY, "it cannot be asked what it has received"),
        (BREAKS_OFF, "it cannot be asked whether a backup is half restored"),
        (HALF_RESTORED, "tools/restore --database"),
    ],
)
def test_standby_that_may_lack_records_is_not_promoted(tmp_path, answer, says):
    """It would take records while it still follows the other one, or has half of a backup."""
    copy_tools(tmp_path, "standby")
    write_programs(tmp_path / "tools", {"compose": COMPOSE.replace("ANSWER", answer)})
    environ = {"PATH": os.environ["PATH"]}
    done = run_command("tools/standby", "promote", cwd=tmp_path, env=environ)
    assert done.returncode == 1
    assert "cannot promote this database" in done.stderr
    assert says in done.stderr
    assert "up --detach" not in (tmp_path / "calls").read_text()
