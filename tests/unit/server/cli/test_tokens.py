"""robotether token, join-token and robot invite."""

import datetime as dt
import re

import pytest
from admin_records import kinds
from robotether_server.db import credentials, join_tokens
from robotether_server.db.join_tokens import Place
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


def test_install_line_is_the_last_line(run, database):
    run("site", "add", "hall")
    run("group", "add", "crew")
    place = ("--site", "hall", "--group", "crew", "--region", "eu")
    lines = run("robot", "invite", "--uses", "3", "--hours", "2", *place).out.splitlines()
    label = re.match(r"join token (robot [0-9a-f]{6}), for 3 robots until ", lines[0])
    words = lines[-1].split()
    assert words[0] == "curl"
    assert "https://robots.example/join.sh" in words
    assert words[words.index("--server") + 1] == "robots.example"
    assert words[words.index("--tls-fingerprint") + 1] == "ab" * 32
    with database.transaction() as tx:
        token = join_tokens.find(tx, words[words.index("--token") + 1])
        assert join_tokens.place_of(tx, token.id) == Place("hall", "crew", "eu")
    assert (token.name, token.uses, token.created_by) == (label[1], 3, "cli")
    lifetime = token.expires_at - dt.datetime.now(dt.UTC)
    assert dt.timedelta(hours=1.9) < lifetime <= dt.timedelta(hours=2)
    assert kinds(database) == ["site_added", "group_added", "join_token_created"]


def test_invited_robot_asks_for_its_name(run, monkeypatch):
    """The line carries the name, which must be one that a single new robot can have."""
    said, line = run("robot", "invite", "--name", "turtle").out.splitlines()
    assert re.match(r"join token turtle [0-9a-f]{6}, for turtle until ", said)
    assert "--name turtle" in line
    assert "several robots" in run("robot", "invite", "--name", "hare", "--uses", "2").err
    assert "cannot use this name" in run("robot", "invite", "--name", "My Robot").err
    # What no robot reaches is warned of beside the line, which scripts read.
    done = run("robot", "invite", "--host", "localhost:443")
    assert done.err.startswith("warning: No robot can use this line: localhost")
    assert "https://localhost/join.sh" in done.out.splitlines()[-1]
    monkeypatch.delenv("PUBLIC_HOST")
    assert "PUBLIC_HOST" in run("robot", "invite").err
