"""The command lines, as OpenSSH itself understands them."""

from __future__ import annotations

import re
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from robotether_agent.ssh_command import (
    Forward,
    SshFiles,
    Target,
    child_environment,
    connect_command,
    control_command,
    forward_to,
    host_key_command,
)

FILES = SshFiles((Path("/s/id_ed25519"),), Path("/s/known_hosts"), Path("/r/session.ctl"))


def in_force(target: Target) -> dict[str, str]:
    """Ask ssh what our command line means."""
    command = connect_command(target, FILES, "session")
    asked = [command[0], "-G", *command[1:]]
    text = subprocess.run(asked, check=True, capture_output=True, text=True).stdout
    return dict(line.partition(" ")[::2] for line in text.splitlines())


def test_ssh_understands_the_options_as_meant():
    """The pin, the key and the time-outs are in force, and nothing asks or adds a key."""
    options = in_force(Target("robots.example.com", 2222, "tunnel"))
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


def test_two_keys_are_shown_in_their_order():
    """While a key is being changed the server may know either."""
    files = replace(FILES, keys=(Path("/s/old"), Path("/s/new")))
    command = connect_command(Target("h", 22, "tunnel"), files, "session")
    assert [word for word in command if word.startswith("IdentityFile")] == [
        "IdentityFile=/s/old",
        "IdentityFile=/s/new",
    ]


@pytest.mark.parametrize(
    ("kind", "class_of_service"),
    # The name is that of OpenSSH before 10.
    [("session", "af21"), ("media", "throughput|0x08"), ("shell", "throughput|0x08")],
)
def test_control_goes_before_a_file_copy(kind, class_of_service):
    """The network hears of it, as far as it listens."""
    command = connect_command(Target("h", 22, "tunnel"), FILES, kind)
    asked = [command[0], "-G", *command[1:]]
    text = subprocess.run(asked, check=True, capture_output=True, text=True).stdout
    assert re.search(rf"^ipqos ({class_of_service}) ", text, re.MULTILINE)


def test_the_host_key_is_checked_without_a_key():
    """The doctor logs in nowhere, and meets the same pin as the agent."""
    command = host_key_command(Target("h", 2222, "tunnel"), Path("/s/known_hosts"))
    asked = [command[0], "-G", *command[1:]]
    text = subprocess.run(asked, check=True, capture_output=True, text=True).stdout
    options = dict(line.partition(" ")[::2] for line in text.splitlines())
    assert options["preferredauthentications"] == "none"
    assert options["userknownhostsfile"] == "/s/known_hosts"
    assert options["stricthostkeychecking"] in {"true", "yes"}
    assert "-M" not in command


def test_an_ipv6_host_is_taken():
    """An address with colons needs no brackets here."""
    assert in_force(Target("2001:db8::1", 443, "tunnel"))["hostname"] == "2001:db8::1"


def test_the_host_can_be_no_option():
    """The host stands after --, whatever it looks like."""
    command = connect_command(Target("h", 22, "tunnel"), FILES, "media")
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
    forward = forward_to(url, 20000)
    assert forward.spec == spec
    command = control_command(Path("/r/x.ctl"), "forward", forward)
    assert command[-4:] == ["-R", spec, "--", "robotether-server"]


def test_a_url_without_a_port_is_refused():
    """The settings always give a port; anything else is an error here."""
    with pytest.raises(ValueError, match="no host and port"):
        forward_to("ws://127.0.0.1", 1)


def test_the_client_inherits_nothing_that_changes_it(monkeypatch):
    """No agent, no askpass, no language of the caller."""
    monkeypatch.setenv("SSH_AUTH_SOCK", "/x")
    assert set(child_environment()) == {"PATH", "LC_ALL"}
    assert Forward(1, "h", 2).spec == "0.0.0.0:1:h:2"
