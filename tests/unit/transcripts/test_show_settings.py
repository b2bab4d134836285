"""`show-settings` of both programs, and how they refuse a wrong value, as a terminal shows it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from syrupy.assertion import SnapshotAssertion
from transcripts import Transcript

ROOT = Path(__file__).resolve().parents[3]
PROGRAMS = {"server": "robotether_server.cli", "agent": "robotether_agent"}

SERVER_SECRETS = {
    "DB_PASSWORD": "secret-of-database",
    "TICKET_KEY": "t" * 32,
    "WEB_SECRET_KEY": "w" * 32,
    "SESSION_KEY": "s" * 32,
    "ADMIN_PASSWORD": "secret-of-the-first-admin",
}
AGENT_SETTINGS = {
    "server": "robots.example:8443",
    "tls_fingerprint": "ab" * 32,
    "ssh_host": "ssh.robots.example",
    "ssh_ports": "2222,443",
    "http_proxy": "http://me:secret@proxy.example:3128",
    "interface": "eth0",
    "allow_local_mac": "yes",
    "name": "turtle",
    "video_source": "rosbridge",
    "video_encoder": "off",
    "cameras": "front=http://me:secret@10.0.0.7/1 back=http://127.0.0.1:81/stream",
    "guard": "off",
    "token": "rtj_secret",
    "log_level": "debug",
}


def run(program: str, *environs: dict[str, str]) -> Transcript:
    """Run a program's show-settings with nothing but these variables, once for each set of them."""
    transcript = Transcript()
    for environ in environs:
        done = subprocess.run(
            [sys.executable, "-m", PROGRAMS[program], "show-settings"],
            env=environ | {"PYTHONPATH": f"{ROOT / program}:{ROOT / 'common'}"},
            check=False,
            capture_output=True,
            text=True,
        )
        for name, value in environ.items():
            transcript.add(f"$ {name}={value}")
        transcript.add("$ show-settings", done.stdout.rstrip())
        transcript.add(f"exit status {done.returncode}", done.stderr.rstrip())
    return transcript


def prefixed(values: dict[str, str]) -> dict[str, str]:
    """Name the agent's settings as its environment does."""
    return {f"ROBOTETHER_{key.upper()}": value for key, value in values.items()}


def test_server_by_default(recorded: SnapshotAssertion) -> None:
    """Every variable stands there with its default."""
    assert run("server", {}) == recorded


def test_server_hides_secrets(recorded: SnapshotAssertion) -> None:
    """A secret that is set is masked, and other values are as they were given."""
    given = {"PUBLIC_HOST": "robots.example", "JOIN_POLICY": "token-only", "SSH_PORTS": "2222,443"}
    assert run("server", SERVER_SECRETS | given) == recorded


def test_server_refuses(recorded: SnapshotAssertion) -> None:
    """A wrong value is one sentence and an exit status; a secret is not shown."""
    assert run("server", {"DB_PORT": "wrong"}, {"TICKET_KEY": "short"}) == recorded


def test_agent_by_default(recorded: SnapshotAssertion) -> None:
    """Every setting stands there with its default."""
    assert run("agent", prefixed({"server": "robots.example"})) == recorded


def test_agent_hides_secrets(recorded: SnapshotAssertion) -> None:
    """The token is hidden, and so are passwords in URLs."""
    assert run("agent", prefixed(AGENT_SETTINGS)) == recorded


def test_agent_refuses(recorded: SnapshotAssertion) -> None:
    """A wrong value is one sentence with what to do, and an exit status."""
    wrong = (
        {},
        {"server": "robots.example", "colour": "red"},
        {"server": "robots.example", "video_source": "wrong"},
        {"server": "robots.example", "http_proxy": "ftp://me:secret@proxy"},
        {"server": "robots.example", "interface": "eth0", "mac": "00:1b:44:11:3a:b7"},
    )
    assert run("agent", *map(prefixed, wrong)) == recorded
