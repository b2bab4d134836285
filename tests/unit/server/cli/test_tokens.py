"""robotether token, join-token and robot invite."""

import datetime as dt
import re

import pytest
from robotether_server.db import credentials
from robotether_server.install_line import Certificate, SiteCertificates

CI = ("--user", "ann", "--name", "ci")


@pytest.fixture(autouse=True)
def _known_certificate(monkeypatch):
    monkeypatch.setattr(
        SiteCertificates, "certificate", lambda *_: Certificate("ab" * 32, "pin=", False)
    )
    monkeypatch.setenv("PUBLIC_HOST", "robots.example")


def test_token_is_the_last_word_of_the_last_line(run, database):
    """It works, and is not listed afterwards."""
    run("user", "add", "ann")
    text = run("token", "create", *CI, "--days", "7").out.splitlines()[-1].split()[-1]
    listed = run("token", "list").out
    assert listed.splitlines()[1].split()[:2] == ["ann", "ci"]
    assert text not in listed
    with database.transaction() as tx:
        assert credentials.get_token_user(tx, text).name == "ann"
        [token] = credentials.list_tokens(tx)
    assert round((token.expires_at - token.created_at) / dt.timedelta(days=1)) == 7
    assert run("token", "delete", *CI).status == 0
    assert "cannot delete token ci" in run("token", "delete", *CI).err


def test_invited_robot_asks_for_its_name(run, monkeypatch):
    """The line carries the name, which must be one that a single new robot can have."""
    said, line = run("robot", "invite", "--name", "turtle").out.splitlines()
    label = re.match(r"join token (turtle [0-9a-f]{6}), for turtle until ", said)[1]
    assert run("join-token", "list").out.splitlines()[1].startswith(f"{label}  0 of 1")
    assert run("join-token", "delete", label).out == f"deleted join token {label}\n"
    assert "there is none of that name" in run("join-token", "delete", label).err
    assert "--name turtle" in line
    assert "several robots" in run("robot", "invite", "--name", "hare", "--uses", "2").err
    assert "cannot use this name" in run("robot", "invite", "--name", "My Robot").err
    # What no robot reaches is warned of beside the line, which scripts read.
    done = run("robot", "invite", "--host", "localhost:443")
    assert done.err.startswith("warning: No robot can use this line: localhost")
    assert "https://localhost/join.sh" in done.out.splitlines()[-1]
    monkeypatch.delenv("PUBLIC_HOST")
    assert "PUBLIC_HOST" in run("robot", "invite").err
