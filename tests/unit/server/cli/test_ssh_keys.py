"""robotether ssh-key and ssh-config."""

import json

import pytest
from admin_records import ADD, activate, kinds
from shell_hosts import make_key

ANN = ("--user", "ann")


@pytest.fixture(autouse=True)
def _ann(run):
    run("user", "add", "ann")


def test_key_is_added_listed_and_deleted(run, database, tmp_path):
    make_key(tmp_path / "id")
    done = run("ssh-key", "add", *ANN, "--name", "laptop", tmp_path / "id.pub")
    assert done.out.startswith("added SSH key laptop of user ann: SHA256:")
    line = make_key(tmp_path / "other")
    assert run("ssh-key", "add", *ANN, stdin=f"{line} ann@desk\n").status == 0
    listed = run("ssh-key", "list", *ANN).out.splitlines()[1:]
    assert sorted(row.split()[0] for row in listed) == ["ann@desk", "laptop"]
    keys = json.loads(run("ssh-key", "list", *ANN, "--json").out)
    assert line in [key["public_key"] for key in keys]
    assert run("ssh-key", "delete", *ANN, "laptop").status == 0
    assert "has none of that name" in run("ssh-key", "delete", *ANN, "laptop").err
    assert kinds(database)[1:] == ["ssh_key_added", "ssh_key_added", "ssh_key_deleted"]


def test_ssh_config_has_the_shells_that_the_user_manages(run, database, monkeypatch):
    assert "PUBLIC_HOST" in run("ssh-config", *ANN).err
    monkeypatch.setenv("SSH_PORTS", "2022,443")
    monkeypatch.setenv("PUBLIC_HOST", "robots.example")
    run(*ADD)
    activate(database)
    refused = run("ssh-config", *ANN)
    assert (refused.status, refused.out) == (1, "")
    assert "manages no active robot whose shell is on" in refused.err
    run("robot", "shell", "sim1", "on")
    run("robot", "set", "sim1", "shell_user=pi")
    run("grant", "ann", "sim1", "manage")
    done = run("ssh-config", *ANN)
    assert done.out.splitlines()[0] == "Host sim1"
    assert "    ProxyJump jump@robots.example:2022\n" in done.out
    assert "    User pi\n" in done.out
    assert "jump@lab.example:" in run("ssh-config", *ANN, "--host", "lab.example").out
