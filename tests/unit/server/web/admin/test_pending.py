"""Keys that wait: shown to be compared, approved, rejected, forgiven."""

import pytest
from admin_visitor import fingerprint, join, send
from robotether_server.db import robots
from robotether_server.problems import RecordMissingError

MAC = "02:00:00:00:51:01"


def key_of(database, name):
    with database.transaction() as tx:
        robot = robots.get(tx, name)
    return robot.state, robot.fingerprint


def asked(action, robot, key):
    return f"/admin/pending/{action}/{robot}?fingerprint=" + fingerprint(key).replace("+", "%2B")


def test_a_refused_join_is_shown_with_its_reason(admin, program):
    page = admin.ask("GET", "/admin/pending").text  # the old address
    assert ('data-testid="nobody-waits"' in page, 'data-testid="refused"' in page) == (True, False)
    join(program, MAC, 1, token="rj_wrong")
    page = admin.ask("GET", "/admin/add-robot").text
    assert f'data-testid="refused-{MAC}"' in page
    for text in ("Cannot accept the join token: it is unknown", "token_invalid", "turtle"):
        assert text in page


def test_an_unknown_robot_is_approved_under_another_name(admin, program, database):
    """The page leads to the robot that approval leads back to."""
    join(program, "02:00:00:00:51:77", 1)
    form = {"robot": "robot-005177", "fingerprint": fingerprint(1), "name": "lift"}
    onward = send(admin, "/admin/pending", **form).location
    assert key_of(database, "lift") == ("active", fingerprint(1))
    assert 'data-testid="arrived-lift"' in admin.ask("GET", onward.partition("#")[0]).text


def test_a_second_machine_with_one_mac_takes_over_only_after_a_page_that_asks(
    admin, program, database
):
    join(program, MAC, 1)
    send(admin, "/admin/pending", robot="sim1", fingerprint=fingerprint(1), name="sim1")
    join(program, MAC, 2, "copy")
    page = admin.ask("GET", "/admin/pending").text
    assert fingerprint(2) in page.replace("</span><span>", "")  # in full, to be compared
    for text in ("robotether-agent status", MAC, "198.51.100.7", "0.1.0"):
        assert text in page
    assert "sim1 is offline, and a machine with its MAC shows a new key" in page
    question = admin.ask("GET", asked("replace", "sim1", 2)).text
    assert "is disconnected within 2 seconds" in question
    assert "copy" in question
    assert key_of(database, "sim1") == ("active", fingerprint(1))
    form = {"fingerprint": fingerprint(2)}
    assert send(admin, "/admin/pending/replace/sim1", **form).status_code == 303
    assert key_of(database, "sim1") == ("active", fingerprint(2))


def test_a_rejected_key_is_refused_until_it_may_ask_again(admin, program, database):
    join(program, "02:00:00:00:51:77", 1)
    assert "Allow the key to ask again" in admin.ask("GET", asked("reject", "robot-005177", 1)).text
    form = {"fingerprint": fingerprint(1)}
    assert send(admin, "/admin/pending/reject/robot-005177", **form).status_code == 303
    with pytest.raises(RecordMissingError):
        key_of(database, "robot-005177")
    assert join(program, "02:00:00:00:51:77", 1).json["code"] == "key_rejected"
    page = admin.ask("GET", "/admin/pending").text
    forgive = page.split('href="/admin/pending/rejected/')[1].split('"')[0]
    assert "ask again?" in admin.ask("GET", f"/admin/pending/rejected/{forgive}").text
    assert send(admin, f"/admin/pending/rejected/{forgive}").status_code == 303
    assert join(program, "02:00:00:00:51:77", 1).status_code == 202
