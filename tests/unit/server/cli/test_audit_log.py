"""robotether audit."""

import json

from admin_records import ADD


def test_log_is_shown_newest_last(run):
    run("user", "add", "ann")
    run(*ADD)
    heads, first, second = run("audit").out.splitlines()
    assert heads.split() == ["AT", "WHO", "FROM", "WHAT", "ROBOT", "DETAILS"]
    assert 'user_added   -      user="ann" role="user"' in first
    assert "robot_added" in second
    for question in (("--robot", "sim1"), ("--kind", "robot_added"), ("--limit", "1")):
        [row] = json.loads(run("audit", *question, "--json").out)
        assert (row["kind"], row["actor"], row["robot"]) == ("robot_added", "cli", "sim1")
    assert json.loads(run("audit", "--actor", "nobody", "--json").out) == []
