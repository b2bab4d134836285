"""robotether robot settings, set."""

import json

import pytest
from admin_records import ADD, kinds, robot
from robotether_server.db import robots
from robotether_server.settings.robot import DEFAULTS


@pytest.fixture(autouse=True)
def _sim1(run):
    run(*ADD)


def test_null_is_the_default(run, database):
    assert json.loads(run("robot", "settings", "sim1").out) == DEFAULTS.as_dict()
    run("robot", "set", "sim1", "guard.max_speed_m_s=1", "guard.deadman_ms=400")
    run("robot", "set", "sim1", "--shell-user", "pi")
    shown = json.loads(run("robot", "settings", "sim1").out)
    assert (shown["guard"]["deadman_ms"], shown["shell_user"]) == (400, "pi")
    done = run("robot", "set", "sim1", "guard.deadman_ms=null", "shell_user=null")
    assert done.out == "robot sim1 has guard.deadman_ms=500 shell_user=null\n"
    assert robot(database).settings == {"guard": {"max_speed_m_s": 1.0}}
    for _ in range(2):
        assert run("robot", "set", "sim1", "guard=null", "policy.drive=null").status == 0
    assert robot(database).settings == {}
    assert kinds(database).count("robot_settings_set") == 4


def test_null_is_meant_where_it_is_a_value(run, database):
    """Driving is then never held because of an old picture; the whole page goes back to the default, which holds it."""
    run("robot", "set", "sim1", "page.hold_after_ms=null", "page.kind=ackermann")
    assert robot(database).settings == {"page": {"hold_after_ms": None, "kind": "ackermann"}}
    done = run("robot", "set", "sim1", "page.hold_after_ms=null", "page.kind=null")
    assert done.out == 'robot sim1 has page.hold_after_ms=null page.kind="differential"\n'
    assert robot(database).settings == {"page": {"hold_after_ms": None}}
    run("robot", "set", "sim1", "page=null")
    assert robot(database).settings == {}


def test_wrong_changes_are_refused(run, database):
    assert "say what" in run("robot", "set", "sim1").err
    for changes, sentence in (
        (["guard.deadman_ms"], "write KEY=VALUE"),
        (["guard.deadman_ms.x=1"], "cannot use guard.deadman_ms: it must be a whole number"),
        (["guard.max_speed_m_s=0,5"], "cannot use guard.max_speed_m_s: it must be null"),
        (["policy.drive.call=" + "[" * 100_000], "cannot use policy.drive.call: it must be a list"),
        (["guard.max_sped=null"], "cannot use guard.max_sped: it is not a setting"),
        (["guard.deadman_ms=300", "guard.deadman_ms=400"], "it is given twice"),
        (["shell_user=pi", "--shell-user", "ubuntu"], "it is given twice"),
    ):
        done = run("robot", "set", "sim1", "guard.max_turn_rad_s=1", *changes)
        assert (done.status, done.err.count("\n"), done.out) == (1, 1, "")
        assert sentence in done.err
    assert robot(database).settings == {}


def test_settings_that_somebody_wrote_by_sql_are_mended(run, database):
    """A robot with settings that nobody may set is locked until then."""
    with database.transaction() as tx:
        robots.set_settings(tx, robots.get(tx, "sim1").id, {"speed": 1, "guard": {"deadman_ms": 5}})
    done = run("robot", "settings", "sim1")
    assert (done.status, done.out) == (1, "")
    assert "'speed' is not a setting" in done.err
    assert "'speed' is not a setting" in run("robot", "set", "sim1", "guard.deadman_ms=400").err
    assert run("robot", "set", "sim1", "guard.deadman_ms=400", "speed=null").status == 0
    assert robot(database).settings == {"guard": {"deadman_ms": 400}}
