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


def ensure_docker(place, engine, compose):
    """Run it where Docker is of these versions."""
    write_programs(place, {"docker": DOCKER})
    environ = {**path_with(place), "ENGINE": engine, "COMPOSE": compose}
    return run_command("tools/ensure_docker", cwd=ROOT, env=environ)


@pytest.mark.parametrize("engine", ["26.0.0", "26.1.5+dfsg1", "29.1.3"])
def test_docker_that_will_do_stays_as_it_is(tmp_path, engine):
    done = ensure_docker(tmp_path, engine, "2.26.1")
    assert done.returncode == 0, done.stderr
    assert "nothing to do" in done.stdout


@pytest.mark.parametrize("engine", ["20.10.24+dfsg1", "25.0.6"])
def test_older_engine_is_refused(tmp_path, engine):
    """It has no mounts of a part of a volume: the stack would fail at its start, in words of Docker's."""
    done = ensure_docker(tmp_path, engine, "v2.40.0")
    assert done.returncode == 1
    assert f"cannot use Docker Engine {engine}: 26.0 or newer is needed" in done.stderr
