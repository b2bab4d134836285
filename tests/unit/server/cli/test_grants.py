"""robotether grant and revoke."""

import datetime as dt

import pytest


@pytest.fixture(autouse=True)
def _ann_and_sim1(run):
    run("user", "add", "ann")
    run("robot", "add", "sim1", "--mac", "00:1b:44:11:3a:b7")


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
