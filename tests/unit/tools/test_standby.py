"""tools/standby with programs in the place of Docker and ssh; tests/images has two real databases."""

import os

import pytest
from commands import copy_tools, path_with, run_command, write_programs

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


@pytest.mark.parametrize(
    ("source", "host"),
    [
        ("a.test:~/my site", "a.test"),
        ("root@::1:my site", "root@::1"),
        ("root@[::1]:my site", "root@::1"),
    ],
)
def test_other_machine_is_asked_in_its_folder(tmp_path, source, host):
    copy_tools(tmp_path, "standby")
    compose = """case "$2" in DB_READ_ONLY) echo ON ;; DB_SERVER_ID) echo 1 ;; *) echo b.test:3306 ;; esac"""
    write_programs(tmp_path / "tools", {"compose": compose})
    (tmp_path / "my site").mkdir()
    write_programs(tmp_path / "my site" / "tools", {"compose": "echo 0 0"})
    write_programs(tmp_path, {"ssh": 'echo "$2" > host; exec sh -c "$3"'})
    done = run_command("tools/standby", "follow", source, cwd=tmp_path, env=path_with(tmp_path))
    assert "it has no binary log" in done.stderr
    assert (tmp_path / "host").read_text() == f"{host}\n"
