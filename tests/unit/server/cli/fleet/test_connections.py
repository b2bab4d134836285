"""Connections through a real jump host, and what is said when there is none."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
from robotether_server.cli.fleet import ssh_settings
from robotether_server.cli.fleet.connections import SshConnections
from robotether_server.cli.fleet.problems import (
    FleetProblem,
    HostKeyChanged,
    HostKeyUnknown,
    LoginRefused,
    Unreachable,
)
from robotether_server.cli.fleet.ssh_settings import Target
from shell_hosts import ShellNetwork, make_key


@pytest.fixture
def connections() -> Iterator[SshConnections]:
    made = SshConnections(accept_new=False)
    yield made
    made.close_all()


def target_of(network: ShellNetwork, name: str = "sim1") -> Target:
    return ssh_settings.resolve(name, network.config)


def refused(network: ShellNetwork, connections: SshConnections) -> FleetProblem:
    with pytest.raises(FleetProblem) as caught:
        connections.open(target_of(network))
    assert "\n" not in caught.value.detail
    return caught.value


def test_robots_share_one_login_at_the_jump_host(
    network: ShellNetwork, connections: SshConnections
) -> None:
    """Even when they come at once."""
    targets = [target_of(network, name) for name in ("sim1", "sim2") * 3]
    with ThreadPoolExecutor(6) as pool:
        opened = list(pool.map(connections.open, targets))
    assert all(connection.is_connected for connection in opened)
    assert network.jump.log().count("Accepted publickey") == 1
    connections.close_all()
    assert not any(connection.is_connected for connection in opened)


def test_offline_robot(network: ShellNetwork, connections: SshConnections) -> None:
    """The jump host finds nothing at its port."""
    network.robots["sim1"].stop()
    problem = refused(network, connections)
    assert isinstance(problem, Unreachable)
    assert problem.detail == "cannot reach sim1: it is offline, the server has no tunnel of it"


def test_robot_that_the_server_does_not_open(
    network: ShellNetwork, connections: SshConnections
) -> None:
    """For want of a grant, or with its shell off."""
    network.let_through("sim2")
    problem = refused(network, connections)
    assert isinstance(problem, LoginRefused)
    assert "a grant to manage it" in problem.detail


def test_keys_that_the_robot_does_not_take(
    network: ShellNetwork, connections: SshConnections
) -> None:
    """The sentence names the user."""
    network.robots["sim1"].authorized.write_text("")
    problem = refused(network, connections)
    assert isinstance(problem, LoginRefused)
    assert f"sim1 as {network.user}: it takes none of your 1 keys" in problem.detail


def test_locked_key(network: ShellNetwork, connections: SshConnections) -> None:
    """The sentence has the command that unlocks it."""
    make_key(network.folder / "locked", "a passphrase")
    network.config.write_text(
        network.config.read_text().replace(f"{network.folder}/id\n", f"{network.folder}/locked\n")
    )
    assert f"ssh-add {network.folder}/locked" in refused(network, connections).detail


def test_no_key_at_all(network: ShellNetwork, connections: SshConnections) -> None:
    """The sentence has the command that makes one."""
    network.config.write_text(network.config.read_text().replace("/id\n", "/none\n"))
    assert "ssh-keygen" in refused(network, connections).detail


def test_jump_host_that_is_away_is_asked_once(
    network: ShellNetwork, connections: SshConnections
) -> None:
    """Every robot's row says the same."""
    network.jump.stop()
    first, second = refused(network, connections), refused(network, connections)
    assert first is second
    assert "the jump host" in first.detail
    assert f"nothing answers at port {network.jump.port}" in first.detail


@pytest.mark.parametrize("accept_new", [False, True])
@pytest.mark.parametrize("which", ["jump", "robot"])
def test_changed_host_key_ends_the_connection(
    network: ShellNetwork, which: str, accept_new: bool
) -> None:
    """The robot's, and the jump host's just so, whatever else is allowed; no key of the person is shown to it."""
    host = network.jump if which == "jump" else network.robots["sim1"]
    host.new_host_key()
    connections = SshConnections(accept_new=accept_new)
    assert isinstance(refused(network, connections), HostKeyChanged)
    connections.close_all()
    assert "Accepted publickey" not in host.log()
    assert "Postponed publickey" not in host.log()


@pytest.mark.parametrize("which", ["jump", "robot"])
def test_unknown_host_key(network: ShellNetwork, connections: SshConnections, which: str) -> None:
    """Is refused, or taken once and for all with --accept-new."""
    name = network.jump_address if which == "jump" else "robotether-sim1"
    lines = network.known_hosts.read_text().splitlines(keepends=True)
    network.known_hosts.write_text("".join(one for one in lines if not one.startswith(name)))
    assert isinstance(refused(network, connections), HostKeyUnknown)
    willing = SshConnections(accept_new=True)
    assert willing.open(target_of(network)).is_connected
    willing.close_all()
    assert network.known_hosts.read_text().count(name + " ") == 1


def test_another_known_type_of_key_is_a_changed_one(
    network: ShellNetwork, connections: SshConnections
) -> None:
    """A server that cannot show the key that is known is not taken for the same."""
    text = network.known_hosts.read_text()
    known = f"robotether-sim1 {network.robots['sim1'].host_key}"
    network.known_hosts.write_text(text.replace(known, "robotether-sim1 ssh-rsa AAAA"))
    assert isinstance(refused(network, connections), HostKeyChanged)


def test_nothing_opens_after_the_end(network: ShellNetwork, connections: SshConnections) -> None:
    """A thread that is late leaves no connection behind."""
    connections.close_all()
    assert "the run is over" in refused(network, connections).detail


def test_unknown_host_name(network: ShellNetwork, connections: SshConnections) -> None:
    """Is told as such."""
    config = network.config.read_text().replace("@127.0.0.1:", "@gate.invalid:")
    network.config.write_text(config)
    assert "there is no host gate.invalid" in refused(network, connections).detail
