"""Fixtures of the playbooks' tests: one server without robots of its own, and hosts that become its robots."""

import time

import pytest
from half_closed import pytest_configure, pytest_sessionfinish  # noqa: F401 - hooks of pytest
from playbooks import Site
from robot_hosts import RobotHosts
from stack import Stack


@pytest.fixture(scope="session")
def stack(tmp_path_factory):
    """The stack alone, removed at the end."""
    running = Stack(tmp_path_factory.mktemp("stack"))
    try:
        running.up(robots=False)
        yield running
    finally:
        running.down()


@pytest.fixture(scope="module")
def hosts(tmp_path_factory):
    """The hosts of one module; each test boots those that it needs."""
    with RobotHosts(tmp_path_factory.mktemp("hosts")) as booted:
        yield booted


@pytest.fixture(scope="module")
def token(stack):
    """An administrator's API token, of a server that has no robots yet."""
    # The hosts of the modules before are gone, and their names and MACs come again.
    stack.sql("DELETE FROM robots; DELETE FROM key_claims")
    return stack.token(f"ansible-{time.monotonic_ns()}")


@pytest.fixture(scope="module")
def site(stack, hosts, token, tmp_path_factory):
    """The administrator, who runs the playbooks."""
    return Site(tmp_path_factory.mktemp("site"), stack, hosts, token)
