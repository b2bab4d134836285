"""One SSH connection: OpenSSH's command lines, its last words, and what stays behind."""

import asyncio
import errno
import os
import re
import shlex
import socket
import subprocess
from contextlib import asynccontextmanager
from pathlib import Path
from unittest.mock import AsyncMock

import pytest
from fake_cloud import eventually
from openssh_server import command_line, descendants, wait_until
from robotether_agent.enrolment.join import parse_host_keys
from robotether_agent.enrolment.keys import ensure_key, pin_host_keys
from robotether_agent.net.server_dialer import SshAddress
from robotether_agent.problems import LinkLostError, SshMissingError
from robotether_agent.tunnel import openssh
from robotether_agent.tunnel.openssh import (
    Forward,
    SshFiles,
    _proxy_options,
    child_environment,
    connect_command,
    control_command,
    host_key_command,
    target_of,
    why_not_connected,
)
from robotether_agent.tunnel.tunnel import Tunnel

FILES = SshFiles((Path("/s/id_ed25519"),), Path("/s/known_hosts"), Path("/r/session.ctl"))
TARGET = SshAddress("robots.example.com", 2222, "tunnel")
CHANGED = "@    WARNING: REMOTE HOST IDENTIFICATION HAS CHANGED!     @"


def in_force(command):
    asked = [command[0], "-G", *command[1:]]
    text = subprocess.run(asked, check=True, capture_output=True, text=True).stdout
    return dict(line.partition(" ")[::2] for line in text.splitlines())


def test_ssh_understands_the_options_as_meant():
    options = in_force(connect_command(TARGET, FILES, "session"))
    assert options["hostname"] == "robots.example.com"
    assert options["port"] == "2222"
    assert options["user"] == "tunnel"
    assert options["batchmode"] == "yes"
    assert options["stricthostkeychecking"] in {"true", "yes"}
    assert options["userknownhostsfile"] == "/s/known_hosts"
    assert options["hostkeyalias"] == "robotether-server"
    assert options["identityfile"] == "/s/id_ed25519"
    assert options["identitiesonly"] == "yes"
    assert options["exitonforwardfailure"] == "yes"
    assert options["controlpath"] == "/r/session.ctl"
    assert options["serveraliveinterval"] == "5"
    assert options["updatehostkeys"] in {"false", "no"}


@pytest.mark.parametrize(
    ("kind", "class_of_service"),
    # The name is that of OpenSSH before 10.
    [("session", "af21"), ("media", "throughput|0x08"), ("shell", "throughput|0x08")],
)
def test_control_goes_before_a_file_copy(kind, class_of_service):
    options = in_force(connect_command(TARGET, FILES, kind))
    assert re.match(rf"({class_of_service}) ", options["ipqos"])


def test_the_host_key_is_checked_without_a_key():
    """The doctor logs in nowhere, and meets the same pin as the agent."""
    command = host_key_command(SshAddress("h", 2222, "tunnel"), Path("/s/known_hosts"))
    options = in_force(command)
    assert options["preferredauthentications"] == "none"
    assert options["userknownhostsfile"] == "/s/known_hosts"
    assert options["stricthostkeychecking"] in {"true", "yes"}
    assert "-M" not in command


def test_the_host_can_be_no_option():
    command = connect_command(SshAddress("h", 22, "tunnel"), FILES, "media")
    assert command[-3:] == ["--", "tunnel@h", "media"]


@pytest.mark.parametrize(
    ("url", "spec"),
    [
        ("ws://127.0.0.1:9090", "0.0.0.0:20000:127.0.0.1:9090"),
        ("http://[::1]:8080", "0.0.0.0:20000:[::1]:8080"),
    ],
)
def test_forwards_listen_on_all_addresses(url, spec):
    """The server's port is open for the relay, which is another machine to sshd."""
    forward = Forward(20000, *target_of(url))
    assert forward.spec == spec
    command = control_command(Path("/r/x.ctl"), "forward", forward)
    assert command[-4:] == ["-R", spec, "--", "robotether-server"]


def test_the_client_inherits_nothing_that_changes_it(monkeypatch):
    monkeypatch.setenv("SSH_AUTH_SOCK", "/x")
    assert set(child_environment()) == {"PATH", "LC_ALL"}


@pytest.mark.parametrize(
    ("words", "status", "code"),
    [
        (f"{CHANGED}\nHost key verification failed.", 255, "host_key_changed"),
        ("No RSA host key is known for robotether-server and you have", 255, "host_key_changed"),
        ("Received disconnect: Too many authentication failures", 255, "key_refused"),
        (
            "Permissions 0644 for '/state/id_ed25519' are too open.\n"
            'Load key "/state/id_ed25519": bad permissions\n'
            "tunnel@a: Permission denied (publickey).",
            255,
            "key_unusable",
        ),
        ("Connection timed out during banner exchange", 255, "server_unreachable"),
        ("kex_exchange_identification: Connection closed", 255, "server_unreachable"),
        ("Connection closed by 192.0.2.1 port 2222", 255, "server_unreachable"),
        ("Unable to negotiate with 192.0.2.1: no matching host key", 255, "ssh_incompatible"),
        ("command-line: line 0: Bad configuration option: x", 255, "ssh_incompatible"),
        ("robotether: cannot reach the relay: it does not answer", 255, "session_refused"),
        ("This account is currently not available.", 1, "session_refused"),
        ("", 1, "session_refused"),
        ("Something new", 255, "link_lost"),
    ],
)
def test_a_client_that_never_connected(words, status, code):
    assert why_not_connected(words.splitlines(), status, TARGET, FILES).code == code


def helper():
    return shlex.split(_proxy_options()[0].removeprefix("ProxyCommand=").replace("%%", "%"))


def test_a_strange_place_is_quoted(monkeypatch):
    """Python may live where a shell, or ssh, would read something else."""
    monkeypatch.setattr(openssh.sys, "executable", "/o p't/%h/python")
    assert helper()[0] == "/o p't/%h/python"
    assert "%%h" in _proxy_options()[0]


# The differentiated services code point, of which TOS has the upper six bits.
AF21 = 18


@pytest.fixture
async def dialer(make_cloud, place):
    cloud = await make_cloud()
    key = await ensure_key(place)
    cloud.authorize(key.public)
    pin_host_keys(place / "known_hosts", parse_host_keys({"host_keys": cloud.ssh.host_keys}))
    files = SshFiles((key.path,), place / "known_hosts", place / "session.ctl")
    return cloud, SshAddress("127.0.0.1", cloud.ssh.port, cloud.ssh.user), files


@asynccontextmanager
async def opened(target, files):
    tunnel = await Tunnel.open(target, files, "session")
    try:
        assert await asyncio.wait_for(tunnel.lines_in.readline(), 10)
        yield tunnel
    finally:
        await tunnel.close()


async def test_a_stale_control_socket_is_removed(dialer):
    cloud, target, files = dialer
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(files.control))
    async with opened(target, files) as tunnel:
        await tunnel.add(Forward(cloud.ports[0], "127.0.0.1", 9))


async def test_a_client_that_an_agent_left_is_ended(dialer):
    _, target, files = dialer
    async with opened(target, files) as left, opened(target, files):
        assert (await left.why_ended(was_connected=True)).code == "link_lost"


@pytest.fixture
async def waiting(place):
    with socket.create_server(("127.0.0.1", 0)) as silent:
        target = SshAddress("127.0.0.1", silent.getsockname()[1], "tunnel")
        files = SshFiles((place / "key",), place / "known_hosts", place / "session.ctl")
        yield await Tunnel.open(target, files, "session")


async def test_a_close_that_is_cut_short_kills(waiting):
    closing = asyncio.ensure_future(waiting.close())
    await asyncio.sleep(0)
    closing.cancel()
    await asyncio.wait({closing})
    await asyncio.wait_for(waiting.close(), 5)
    wait_until(lambda: not clients(), lambda: "ssh has ended", 5)


async def test_the_client_runs_on_our_connection(dialer):
    cloud, target, files = dialer
    async with opened(target, files) as tunnel:
        assert tunnel.socket.getpeername() == ("127.0.0.1", cloud.ssh.port)
        assert tunnel.socket.getsockopt(socket.IPPROTO_IP, socket.IP_TOS) == AF21 << 2
    assert tunnel.socket.fileno() == -1


async def test_no_descriptor_stays_open(dialer, place, monkeypatch):
    _, target, files = dialer
    before = _descriptors()
    async with opened(target, files):
        pass
    with monkeypatch.context() as without_ssh:
        without_ssh.setenv("PATH", str(place))
        with pytest.raises(SshMissingError, match="openssh-client"):
            await Tunnel.open(target, files, "session")
    await eventually(lambda: _descriptors() <= before, lambda: f"{_descriptors()} of {before}")


async def test_a_client_that_cannot_start_ends_nothing_else(dialer, monkeypatch):
    """A robot whose memory is full keeps the connections that it has, and tries this one again."""
    _, target, files = dialer
    fails = AsyncMock(side_effect=OSError(errno.ENOMEM, "Cannot allocate memory"))
    monkeypatch.setattr(asyncio, "create_subprocess_exec", fails)
    with pytest.raises(LinkLostError, match="Cannot allocate memory"):
        await Tunnel.open(target, files, "media")


def clients():
    return [pid for pid in descendants(os.getpid()) if "session.ctl" in command_line(pid)]


def _descriptors():
    return len(list(Path("/proc/self/fd").iterdir()))
