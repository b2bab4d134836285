"""tools/ensure_docker on a machine that has Docker already, with a program in its place."""

from pathlib import Path

import pytest
from commands import path_with, run_command, write_programs

ROOT = Path(__file__).resolve().parents[3]
DOCKER = """#!/bin/sh
case "$*" in
  'version --format {{.Server.Version}}') echo "$ENGINE" ;;
  'compose version --short') echo "$COMPOSE" ;;
  --version) echo 'Docker version 1, build 2' ;;
esac
"""


@pytest.mark.parametrize(
    ("engine", "is_refused"),
    [("26.0.0", False), ("26.1.5+dfsg1", False), ("20.10.24+dfsg1", True), ("25.0.6", True)],
)
def test_older_engine_is_refused(tmp_path, engine, is_refused):
    """It has no mounts of a part of a volume: the stack would fail at its start, in words of Docker's."""
    write_programs(tmp_path, {"docker": DOCKER})
    environ = {**path_with(tmp_path), "ENGINE": engine, "COMPOSE": "v2.40.0"}
    done = run_command("tools/ensure_docker", cwd=ROOT, env=environ)
    assert done.returncode == is_refused, done.stderr
    assert (
        f"cannot use Docker Engine {engine}: 26.0 or newer is needed" in done.stderr
    ) == is_refused
