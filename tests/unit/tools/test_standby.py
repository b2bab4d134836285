"""tools/standby promote, with a program in the place of Docker; tests/images has two real databases."""

import os
import shutil
from pathlib import Path

import pytest
from commands import run_command, write_programs

ROOT = Path(__file__).resolve().parents[3]
# A standby that has received something, whose database runs if the file `runs` is there.
COMPOSE = """#!/bin/sh
echo "$*" >> calls
case "$*" in
  '--env DB_READ_ONLY') echo OFF ;;
  exec*) [ -e runs ] || { echo 'service "mysql" is not running' >&2; exit 1; } ;;
esac
case "$*" in
  *'SHOW REPLICA STATUS'*) printf '  Slave_IO_Running: Connecting\\n  Gtid_IO_Pos: 0-1-7\\n' ;;
  *MASTER_GTID_WAIT*) echo 0 ;;
esac
"""


@pytest.fixture
def checkout(tmp_path):
    """A checkout with the tool."""
    (tmp_path / "tools").mkdir()
    for name in ("standby", "common.sh"):
        shutil.copy(ROOT / "tools" / name, tmp_path / "tools")
    write_programs(tmp_path / "tools", {"compose": COMPOSE})
    return tmp_path


def promote(checkout):
    """Run the tool: how it ended, what it said, and what it asked Docker."""
    environ = {"PATH": os.environ["PATH"]}
    done = run_command("tools/standby", "promote", cwd=checkout, env=environ)
    return done.returncode, done.stdout + done.stderr, (checkout / "calls").read_text()


def test_standby_takes_records_once_it_follows_no_longer(checkout):
    """What it has received is in its tables before."""
    (checkout / "runs").touch()
    code, said, asked = promote(checkout)
    assert code == 0, said
    steps = ["MASTER_GTID_WAIT('0-1-7'", "RESET SLAVE ALL", "up --detach", "ENABLE"]
    places = [asked.index(step) for step in steps]
    assert places == sorted(places)


def test_standby_that_cannot_be_asked_is_not_promoted(checkout):
    """It would take records while it still follows the other one."""
    code, said, asked = promote(checkout)
    assert code == 1
    assert "cannot promote this database" in said
    assert "up --detach" not in asked
