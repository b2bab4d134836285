"""What agent/join.sh refuses to do before it looks at the machine; tests/ansible/test_join_line.py tries the rest."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[3] / "agent/join.sh"


def run(*options: str) -> subprocess.CompletedProcess[str]:
    command = ["sh", str(SCRIPT), *options]
    return subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)


def test_no_image_holds_an_api_token() -> None:
    """Every card would give whoever finds it the rights of the token's user."""
    done = run("--server", "robots.example", "--token", "rt_x", "--image")
    assert done.returncode == 1
    assert "cannot put an API token into an image" in done.stderr
    assert "rt_x" not in done.stderr


def test_certificate_that_authorities_know_needs_no_fingerprint() -> None:
    """The line that the server prints then has none; what stops this run comes after the options."""
    done = run("--server", "robots.example", "--wheelhouse", "/nowhere")
    assert done.returncode == 1
    assert "cannot use --wheelhouse /nowhere" in done.stderr
    wrong = run("--server", "robots.example", "--tls-fingerprint", "abc")
    assert "cannot use --tls-fingerprint abc" in wrong.stderr


@pytest.mark.parametrize(
    "value", ["a b", "a;id", "$(id)", "`id`", 'a"b', "a\\b", "a\nb", "-x", "", "a'b", "a|b", "a>b"]
)
def test_no_value_is_more_than_a_word(value: str) -> None:
    """Values become lines of a file and arguments of commands that root runs."""
    done = run("--server", value)
    assert done.returncode == 1
    assert "cannot use --server" in done.stderr
