"""robotether grant and revoke."""

import datetime as dt

import pytest


@pytest.fixture(autouse=True)
def _ann_and_sim1(run):
    run("user", "add", "ann")
    run("robot", "add", "sim1", "--mac", "00:1b:44:11:3a:b7")


def test_options_stand_in_for_user_and_robot(run):
    run("group", "add", "crew")
    run("site", "add", "lab")
    for words, who, level, what in (
        (("--group", "crew", "sim1"), "group crew", "drive", "robot sim1"),
        (("ann", "--site", "lab"), "user ann", "manage", "site lab"),
        (("--group", "crew", "--all"), "group crew", "observe", "all robots"),
    ):
        assert run("grant", *words, level).out == f"{who} may {level} {what}\n"
        assert run("revoke", *words).out == f"{who} no longer has a grant for {what}\n"
    assert run("grant", "ann", "manage", "--site=lab").out == "user ann may manage site lab\n"
    # A user may be called like a command: three words are always USER ROBOT LEVEL.
    run("user", "add", "list")
    assert run("grant", "list", "sim1", "drive").out == "user list may drive robot sim1\n"


def test_grant_has_an_end(run):
    """A day is meant with its last second in UTC; one that has passed is refused."""
    day = (dt.datetime.now(dt.UTC) + dt.timedelta(days=2)).date()
    done = run("grant", "ann", "sim1", "drive", "--until", str(day))
    assert done.out == f"user ann may drive robot sim1 until {day} 23:59:59 UTC\n"
    assert f"{day} 23:59:59" in run("grant", "list").out
    for wrong in ("2020-01-01", "soon", "2999-01-01"):
        assert run("grant", "ann", "sim1", "manage", "--until", wrong).status == 1
    assert "drive" in run("grant", "list").out


def test_mistake_in_the_arguments(run):
    for words, says in (
        (("ann", "sim1", "fly"), "'observe', 'drive', 'manage'"),
        (("ann",), "Missing argument"),
        (("ann", "sim1", "sim2", "drive"), ""),
        (("ann", "--all", "--site", "lab", "drive"), ""),
    ):
        done = run("grant", *words)
        assert (done.status, says in done.err) == (2, True), words
    assert len(run("grant", "list").out.splitlines()) == 1
