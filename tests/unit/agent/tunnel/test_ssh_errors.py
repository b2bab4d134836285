"""What OpenSSH's words mean; real clients say the same lines in test_agent.py."""

from __future__ import annotations

from pathlib import Path

import pytest
from robotether_agent.net.server_dialer import Target
from robotether_agent.tunnel.ssh_command import Forward, SshFiles
from robotether_agent.tunnel.ssh_errors import why_ended, why_no_forward, why_not_connected

TARGET = Target("robots.example.com", 2222, "tunnel")
FILES = SshFiles((Path("/state/id_ed25519"),), Path("/state/known_hosts"), Path("/run/session.ctl"))
CHANGED = "@    WARNING: REMOTE HOST IDENTIFICATION HAS CHANGED!     @"


@pytest.mark.parametrize(
    ("words", "status", "code"),
    [
        ([CHANGED, "Host key verification failed."], 255, "host_key_changed"),
        (
            [
                "No RSA host key is known for robotether-server and you have requested strict checking."
            ],
            255,
            "host_key_changed",
        ),
        (["tunnel@robots.example.com: Permission denied (publickey)."], 255, "key_refused"),
        (["Received disconnect: Too many authentication failures"], 255, "key_refused"),
        (
            [
                "Permissions 0644 for '/state/id_ed25519' are too open.",
                'Load key "/state/id_ed25519": bad permissions',
                "tunnel@robots.example.com: Permission denied (publickey).",
            ],
            255,
            "key_unusable",
        ),
        (["ssh: connect to host a port 2222: Connection refused"], 255, "server_unreachable"),
        (["ssh: connect to host a port 2222: No route to host"], 255, "server_unreachable"),
        (["ssh: connect to host a port 2222: Connection timed out"], 255, "server_unreachable"),
        (
            ["ssh: Could not resolve hostname a: Name or service not known"],
            255,
            "server_unreachable",
        ),
        (["Connection timed out during banner exchange"], 255, "server_unreachable"),
        (
            ["kex_exchange_identification: Connection closed by remote host"],
            255,
            "server_unreachable",
        ),
        (["Connection closed by 192.0.2.1 port 2222"], 255, "server_unreachable"),
        (
            ["Unable to negotiate with 192.0.2.1 port 22: no matching host key type found."],
            255,
            "ssh_incompatible",
        ),
        (["command-line: line 0: Bad configuration option: x"], 255, "ssh_incompatible"),
        (["robotether: cannot reach the relay: it does not answer"], 255, "session_refused"),
        (["This account is currently not available."], 1, "session_refused"),
        ([], 1, "session_refused"),
        (["Something new"], 255, "link_lost"),
    ],
)
def test_a_client_that_never_connected(words, status, code):
    """Each reason why ssh ends before a configuration is one problem with its own code."""
    assert why_not_connected(words, status, TARGET, FILES).code == code


def test_host_key_problem_says_what_to_do():
    """The loudest problem names the server, the file to remove, and to ask first."""
    text = str(why_not_connected([CHANGED], 255, TARGET, FILES))
    assert "robots.example.com port 2222" in text
    assert "/state/known_hosts" in text
    assert "ask the server's administrator" in text


def test_a_client_that_was_connected():
    """A connection that stood is lost, in ssh's own words."""
    words = ["Timeout, server robots.example.com not responding."]
    problem = why_ended(words, 255, TARGET)
    assert problem.code == "link_lost"
    assert "not responding" in problem.message
    assert "ssh was killed" in why_ended([], -9, TARGET).message


def test_a_forward_that_was_refused():
    """A port that the server does not open is named."""
    forward = Forward(20000, "127.0.0.1", 9090)
    words = [
        "mux_client_forward: forwarding request failed: remote port forwarding failed for listen port 20000"
    ]
    problem = why_no_forward(words, forward, "forward")
    assert problem.code == "port_taken"
    assert "port 20000" in problem.message
    other = why_no_forward(["Control socket connect(/x): Connection refused"], forward, "forward")
    assert other.code == "forward_failed"
