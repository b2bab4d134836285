"""Fixtures of the playbooks' tests: one server without robots of its own, and hosts that become its robots."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from half_closed import pytest_configure, pytest_sessionfinish  # noqa: F401 - hooks of pytest
from playbooks import Site, build_wheel, pip_environment
from robot_hosts import IMAGE, ROOT, RobotHosts
from stack import Stack


@pytest.fixture(scope="session")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """The stack alone, removed at the end."""
    running = Stack(tmp_path_factory.mktemp("stack"))
    try:
        running.up(robots=False)
        yield running
    finally:
        running.down()


@pytest.fixture(scope="module")
def hosts(wheelhouse: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RobotHosts]:
    """The hosts of one module; each test boots those that it needs."""
    with RobotHosts(tmp_path_factory.mktemp("hosts"), wheelhouse) as booted:
        yield booted


@pytest.fixture(scope="module")
def site(
    stack: Stack, hosts: RobotHosts, wheel: Path, tmp_path_factory: pytest.TempPathFactory
) -> Site:
    """An administrator with an API token, who runs the playbooks, of a server that has no robots yet."""
    forget_robots(stack)
    token = stack.token(f"ansible-{time.monotonic_ns()}")
    variables = {"robotether_wheel_file": str(wheel)}
    return Site(tmp_path_factory.mktemp("site"), stack, hosts, token, variables)


def forget_robots(stack: Stack) -> None:
    """Remove what the modules before left: their hosts are gone, and their names and MACs come again."""
    stack.sql("DELETE FROM robots")
    stack.sql("DELETE FROM key_claims")


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The agent of this checkout, the same for all tests of a run whoever edits it meanwhile."""
    return build_wheel(ROOT / "agent", tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="session")
def wheelhouse(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the agent needs as wheels, for robots without internet; a host's own Python says what that is."""
    folder = tmp_path_factory.mktemp("wheelhouse")
    bundle = pip_environment().get("PIP_CERT")
    command = [
        "docker", "run", "--rm", "--network", "host", "--volume", f"{folder}:/wheelhouse",
        "--volume", f"{ROOT / 'agent' / 'requirements.txt'}:/requirements.txt:ro",
        *(["--volume", f"{bundle}:/ca.pem:ro", "--env", "PIP_CERT=/ca.pem"] if bundle else []),
        IMAGE, "/opt/sim_robot/venv/bin/pip", "download", "--quiet", "--only-binary", ":all:",
        "--require-hashes", "--dest", "/wheelhouse", "--requirement", "/requirements.txt",
    ]  # fmt: skip
    subprocess.run(command, check=True, timeout=180)
    return folder
