"""robotether grant and revoke."""

from __future__ import annotations

import datetime as dt
import json

import pytest
from admin_records import Run, kinds
from robotether_server.db import Database, seen_robots, users


@pytest.fixture(autouse=True)
def _ann_and_sim1(run: Run) -> None:
    run("user", "add", "ann")
    run("robot", "add", "sim1", "--mac", "00:1b:44:11:3a:b7")


def test_grant_is_given_and_taken(run: Run, database: Database) -> None:
    """Each with its audit event; taking one that is not there fails."""
    assert run("grant", "ann", "sim1", "drive").out == "user ann may drive robot sim1\n"
    with database.transaction() as tx:
        assert [seen.level for seen in seen_robots.list_seen(tx, users.get(tx, "ann"))] == ["drive"]
    assert run("revoke", "ann", "sim1").status == 0
    done = run("revoke", "ann", "sim1")
    assert (done.status, done.err) == (
        1,
        "robotether: cannot revoke: user ann has no grant for robot sim1\n",
    )
    assert kinds(database)[2:] == ["grant_given", "grant_taken"]


def test_grants_are_listed(run: Run) -> None:
    """Grants are listed for people and for programs."""
    run("grant", "ann", "sim1", "manage")
    line = run("grant", "list").out.splitlines()[1]
    assert line.split() == ["user", "ann", "robot", "sim1", "manage", "-"]
    (found,) = json.loads(run("grant", "list", "--json").out)
    assert (found["user"], found["robot"], found["level"]) == ("ann", "sim1", "manage")
    assert (found["group"], found["site"], found["all"], found["ends_at"]) == (
        None,
        None,
        False,
        None,
    )


@pytest.mark.parametrize("name", ["list", "give"])
def test_users_may_be_called_like_a_command(run: Run, name: str) -> None:
    """Three words are always USER ROBOT LEVEL."""
    run("user", "add", name)
    assert run("grant", name, "sim1", "drive").out == f"user {name} may drive robot sim1\n"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [(("ann", "sim1", "fly"), "'observe', 'drive', 'manage'"), (("ann",), "Missing argument")],
)
def test_mistake_in_the_arguments(run: Run, arguments: tuple[str, ...], says: str) -> None:
    """Is exit status 2, and says what there is."""
    done = run("grant", *arguments)
    assert done.status == 2
    assert says in done.err


def test_help_shows_both_ways(run: Run) -> None:
    """What to write, and the list."""
    done = run("grant", "--help")
    assert "robotether grant [OPTIONS] USER ROBOT LEVEL [--until END] | list" in done.out


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--group", "crew", "sim1", "drive"), "group crew may drive robot sim1"),
        (("ann", "--site", "lab", "manage"), "user ann may manage site lab"),
        (("ann", "manage", "--site=lab"), "user ann may manage site lab"),
        (("--group", "crew", "--all", "observe"), "group crew may observe all robots"),
    ],
)
def test_options_stand_in_for_user_and_robot(run: Run, words: tuple[str, ...], says: str) -> None:
    """Wherever they stand; revoke takes the same."""
    run("group", "add", "crew")
    run("site", "add", "lab")
    assert run("grant", *words).out == says + "\n"
    who, what = says.split(" may ")
    what = what.split(" ", 1)[1]
    rest = [word for word in words if word not in {"drive", "manage", "observe"}]
    assert run("revoke", *rest).out == f"{who} no longer has a grant for {what}\n"


def test_grant_has_an_end(run: Run) -> None:
    """A day is meant with its last second in UTC; one that has passed is refused."""
    day = (dt.datetime.now(dt.UTC) + dt.timedelta(days=2)).date()
    done = run("grant", "ann", "sim1", "drive", "--until", str(day))
    assert done.out == f"user ann may drive robot sim1 until {day} 23:59:59 UTC\n"
    assert f"{day} 23:59:59" in run("grant", "list").out
    for wrong in ("2020-01-01", "soon", "2999-01-01"):
        assert run("grant", "ann", "sim1", "manage", "--until", wrong).status == 1
    assert "drive" in run("grant", "list").out


@pytest.mark.parametrize(
    "words",
    [
        ("ann", "sim1", "sim2", "drive"),
        ("--group", "crew", "ann", "sim1", "drive"),
        ("ann", "--all", "--site", "lab", "drive"),
        ("ann", "--all", "sim1", "drive"),
        ("--all",),
    ],
)
def test_too_much_or_too_little_is_a_mistake(run: Run, words: tuple[str, ...]) -> None:
    """Exit status 2, and nothing is given."""
    assert run("grant", *words).status == 2
    assert len(run("grant", "list").out.splitlines()) == 1
