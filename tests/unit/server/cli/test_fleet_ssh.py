"""Robots in OpenSSH's configuration, connections through a real jump host, and what is said when there is none."""

import os
import subprocess
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import paramiko
import pytest
from openssh_server import make_key, wait_until
from robotether_server.cli import fleet_ssh
from robotether_server.cli.fleet_ssh import (
    FleetError,
    HostKeyCheck,
    Identities,
    SshConnections,
)

# What tells a host with another key from one that nobody has compared yet.
CHANGED, UNKNOWN = "shows another host key than the one known", "is not known as"
ROBOTS = """
Host sim1
    HostName 127.0.0.1
    HostKeyAlias robotether-sim1
Host sim2
    HostKeyAlias=robotether-sim2
"""
OTHERS = """
# Host commented
Host bank
    HostKeyAlias my-bank
Host *.lab !gate
    HostKeyAlias robotether-x
Match host sim3
    HostKeyAlias robotether-sim3
Host "an unfinished quote
"""


@pytest.fixture
def connections():
    made = SshConnections(accept_new=False)
    yield made
    made.close_all()


def target_of(network, name="sim1"):
    return fleet_ssh.resolve(name, network.config)


def refused(network, connections):
    with pytest.raises(FleetError) as caught:
        connections.open(target_of(network))
    assert "\n" not in caught.value.detail
    return caught.value


def test_robots_share_one_login_at_the_jump_host(network, connections):
    targets = [target_of(network, name) for name in ("sim1", "sim2") * 3]
    with ThreadPoolExecutor(6) as pool:
        opened = list(pool.map(connections.open, targets))
    assert all(connection.is_connected for connection in opened)
    assert network.jump.log_text().count("Accepted publickey") == 1
    connections.close_all()
    assert not any(connection.is_connected for connection in opened)


def lock_key(network):
    make_key(network.folder / "locked", "a passphrase")
    rename_key(network, "locked")


def rename_key(network, name):
    replace_in(network, "/id\n", f"/{name}\n")


def replace_in(network, old, new):
    network.config.write_text(network.config.read_text().replace(old, new))


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda net: net.robots["sim1"].stop(), "cannot reach sim1: it is offline: the server has no tunnel to it"),
        (lambda net: net.let_through("sim2"), "a grant to manage it"),
        (lambda net: net.robots["sim1"].authorized.write_text(""), "sim1 as {0.user}: it accepts none of your 1 keys"),
        (lock_key, "ssh-add {0.folder}/locked"),
        (lambda net: rename_key(net, "none"), "ssh-keygen"),
        (lambda net: replace_in(net, "@127.0.0.1:", "@gate.invalid:"), "there is no host gate.invalid"),
    ],
    ids=["offline", "not_opened", "key_not_taken", "key_locked", "no_key", "no_host"],
)  # fmt: skip
def test_sentence_says_why_a_robot_is_not_reached(network, connections, spoil, sentence):
    spoil(network)
    assert sentence.format(network) in refused(network, connections).detail


def test_jump_host_that_is_away_is_asked_once(network, connections):
    network.jump.stop()
    first, second = refused(network, connections), refused(network, connections)
    assert first is second
    assert "the jump host" in first.detail
    assert f"nothing answers at port {network.jump.port}" in first.detail


@pytest.mark.parametrize("which", ["jump", "robot"])
def test_changed_host_key_ends_the_connection(network, which):
    before = network.known_hosts.read_text()
    host = network.jump if which == "jump" else network.robots["sim1"]
    host.come_back_as_another()
    for accept_new in (False, True):
        connections = SshConnections(accept_new=accept_new)
        detail = refused(network, connections).detail
        connections.close_all()
        assert CHANGED in detail
        assert "ssh-keygen -R '" in detail
    assert network.known_hosts.read_text() == before
    assert "Accepted publickey" not in host.log_text()
    assert "Postponed publickey" not in host.log_text()
    # A server that cannot show the key that is known is not taken for the same.
    if which == "robot":
        other = make_key(network.folder / "other", kind="ecdsa")
        known = [line for line in before.splitlines() if not line.startswith("robotether-sim1 ")]
        network.known_hosts.write_text("\n".join([*known, f"robotether-sim1 {other}", ""]))
        connections = SshConnections(accept_new=True)
        assert CHANGED in refused(network, connections).detail
        connections.close_all()


@pytest.mark.parametrize("which", ["jump", "robot"])
def test_unknown_host_key(network, connections, which):
    name = network.jump_address if which == "jump" else "robotether-sim1"
    lines = network.known_hosts.read_text().splitlines(keepends=True)
    network.known_hosts.write_text("".join(item for item in lines if not item.startswith(name)))
    detail = refused(network, connections).detail
    assert UNKNOWN in detail
    assert "--accept-new" in detail
    willing = SshConnections(accept_new=True)
    assert willing.open(target_of(network)).is_connected
    willing.close_all()
    assert network.known_hosts.read_text().count(name + " ") == 1


@pytest.fixture
def agent(tmp_path, monkeypatch):
    socket = tmp_path / "agent"
    process = subprocess.Popen(["ssh-agent", "-D", "-a", str(socket)], stdout=subprocess.DEVNULL)
    try:
        wait_until(socket.exists, lambda: "ssh-agent listens")
        monkeypatch.setenv("SSH_AUTH_SOCK", str(socket))
        yield
    finally:
        process.terminate()
        process.wait(10)


def add_to_agent(path):
    """Add a key, then leave only its public half."""
    subprocess.run(["ssh-add", "-q", str(path)], check=True, env=os.environ)
    path.unlink()


def offered(target):
    identities = Identities(target)
    try:
        sources = list(identities.get_sources())
        assert identities.tried == len(sources)
        assert all(source.username == target.user for source in sources)
        return [f"{source.pkey.get_name()} {source.pkey.get_base64()}" for source in sources]
    finally:
        identities.close()


@pytest.mark.usefixtures("agent")
def test_the_agent_is_that_of_the_configuration(tmp_path, monkeypatch):
    line = make_key(tmp_path / "key")
    add_to_agent(tmp_path / "key")
    config = tmp_path / "config"

    def offered_by(agent):
        config.write_text(f"Host sim1\nIdentityFile none\nIdentityAgent {agent}\n")
        return offered(fleet_ssh.resolve("sim1", config))

    assert offered_by("none") == []
    assert offered_by("SSH_AUTH_SOCK") == [line]
    monkeypatch.setenv("OTHER", os.environ["SSH_AUTH_SOCK"])
    monkeypatch.delenv("SSH_AUTH_SOCK")
    assert offered_by("$OTHER") == [line]


@pytest.mark.usefixtures("agent")
def test_agents_keys_come_in_the_order_of_the_configuration(target, tmp_path):
    """The named key is first, then the agent's others, then files: a server that allows three tries sees the best."""
    lines = {name: make_key(tmp_path / name) for name in ("other", "named", "file")}
    named = (tmp_path / "named").read_text()
    add_to_agent(tmp_path / "other")
    add_to_agent(tmp_path / "named")
    files = (tmp_path / "file", tmp_path / "named", tmp_path / "missing")
    target = replace(target, identity_files=files, identities_only=False)
    assert offered(target) == [lines["named"], lines["other"], lines["file"]]
    (tmp_path / "named").write_text(named)  # nevertheless offered once
    (tmp_path / "missing").write_text("rubbish")
    assert offered(target) == [lines["named"], lines["other"], lines["file"]]
    assert offered(replace(target, identities_only=True)) == [lines["named"], lines["file"]]


@pytest.fixture
def key(tmp_path):
    make_key(tmp_path / "host")
    return paramiko.PKey.from_path(tmp_path / "host")


def write(target, *lines):
    target.known_hosts[0].write_text("".join(f"{line}\n" for line in lines))


def line(key, name="robotether-sim1"):
    return f"{name} {key.get_name()} {key.get_base64()}"


def check(target, key, *, accept_new=False):
    HostKeyCheck(target, accept_new=accept_new).missing_host_key(None, "[127.0.0.1]:24000", key)


@pytest.mark.parametrize("accept_new", [False, True])
def test_revoked_key_is_never_taken(target, key, accept_new):
    """A key that cannot be noted, or is known for the address alone, is refused, too."""
    write(target, line(key, "[127.0.0.1]:24000"))
    with pytest.raises(FleetError, match="no UserKnownHostsFile" if accept_new else UNKNOWN):
        check(replace(target, known_hosts=()), key, accept_new=accept_new)
    if not accept_new:
        with pytest.raises(FleetError, match=UNKNOWN):
            check(target, key)
    write(target, line(key), f"@revoked {line(key, '*')}")
    with pytest.raises(FleetError, match="revoked"):
        check(target, key, accept_new=accept_new)


def test_sentence_says_what_is_wrong_here(tmp_path, monkeypatch):
    config = tmp_path / "config"
    for line, says in (
        ("ProxyCommand nc %h %p", r"sim1: its entry has a ProxyCommand.*ProxyJump"),
        ("Prot 22", r"(?s)cannot reach sim1: ssh says: .*line 2.*prot"),
    ):
        config.write_text(f"Host sim1\n    {line}\n")
        with pytest.raises(FleetError, match=says):
            fleet_ssh.resolve("sim1", config)
    monkeypatch.setenv("PATH", "")
    with pytest.raises(FleetError, match="install OpenSSH's client"):
        fleet_ssh.resolve("sim1", config)


def test_paths_may_have_spaces(tmp_path):
    config, folder = tmp_path / "config", tmp_path / "ann lee"
    files = f'IdentityFile "{folder}/id"\nUserKnownHostsFile "{folder}/known" /b\n'
    config.write_text(f"Host sim1\n{files}GlobalKnownHostsFile none\n")
    target = fleet_ssh.resolve("sim1", config)
    assert target.identity_files == (folder / "id",)
    assert target.known_hosts == (folder / "known", Path("/b"))


def test_tokens_in_paths_of_keys_have_their_values(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    config = tmp_path / "config"
    files = "".join(f"IdentityFile {file}\n" for file in ("%d/%r@%h", "${HOME}/50%%", "~/%r"))
    config.write_text(f"Host sim1\nHostName 192.0.2.1\nUser pi\n{files}")
    names = ("pi@192.0.2.1", "50%", "pi")
    found = fleet_ssh.resolve("sim1", config).identity_files
    assert found == tuple(tmp_path / name for name in names)


def test_patterns_choose_what_the_server_printed(tmp_path, monkeypatch):
    """A person's other hosts, patterns and broken lines are no robots; included files are read."""
    listed, home = tmp_path / "listed", tmp_path / ".ssh"
    listed.write_text(ROBOTS + OTHERS)
    for patterns, names in ((["*"], ["sim1", "sim2"]), (["sim2", "*2"], ["sim2"])):
        assert fleet_ssh.choose(listed, patterns) == names
    with pytest.raises(FleetError, match=r"for bank: .* has sim1, sim2; .* robotether ssh-config"):
        fleet_ssh.choose(listed, ["*", "bank"])
    with pytest.raises(FleetError, match=r"cannot read .*missing.* robotether ssh-config"):
        fleet_ssh.choose(tmp_path / "missing", ["*"])
    monkeypatch.setenv("HOME", str(tmp_path))
    home.mkdir()
    (home / "fleet.conf").write_text(ROBOTS.replace("sim2", "turtle"))
    (home / "config").write_text(f"Include fleet.* {listed}\n")
    assert fleet_ssh.choose(None, ["*"]) == ["sim1", "sim2", "turtle"]
