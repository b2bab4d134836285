"""Fixtures of the playbooks' tests: one server without robots of its own, and hosts that become its robots."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playbooks import Site
from robot_hosts import RobotHosts
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
def hosts(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RobotHosts]:
    """The hosts of one module; each test boots those that it needs."""
    with RobotHosts(tmp_path_factory.mktemp("hosts")) as booted:
        yield booted


@pytest.fixture(scope="module")
def site(stack: Stack, hosts: RobotHosts, tmp_path_factory: pytest.TempPathFactory) -> Site:
    """An administrator with an API token, who runs the playbooks."""
    return Site(tmp_path_factory.mktemp("site"), stack, hosts, stack.token("ansible"))
