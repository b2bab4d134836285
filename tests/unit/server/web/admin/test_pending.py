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


def approve(admin, robot, key, name=None):
    form = {"robot": robot, "fingerprint": fingerprint(key), "name": name or robot}
    return send(admin, "/admin/pending", **form).status_code


def asked(action, robot, key):
    return f"/admin/pending/{action}/{robot}?fingerprint=" + fingerprint(key).replace("+", "%2B")


def test_nobody_waits_at_first(admin):
    """The page says how somebody comes to; it is at the old address, too."""
    for path in ("/admin/add-robot", "/admin/pending"):
        assert 'data-testid="nobody-waits"' in admin.ask("GET", path).text


def test_a_refused_join_is_shown_with_its_reason(admin, program):
    """The admin who waits for the machine sees why it does not come."""
    assert 'data-testid="refused"' not in admin.ask("GET", "/admin/add-robot").text
    join(program, MAC, 1, token="rj_wrong")
    page = admin.ask("GET", "/admin/add-robot").text
    assert f'data-testid="refused-{MAC}"' in page
    for text in ("Cannot accept the join token: it is unknown", "token_invalid", "turtle"):
        assert text in page
    assert "nobody-waits" not in page


def test_a_key_is_shown_in_full_with_what_to_compare(admin, program):
    join(program, MAC, 1)
    page = admin.ask("GET", "/admin/pending").text
    assert fingerprint(1) in page.replace("</span><span>", "")
    for text in ("robotether-agent status", MAC, "turtle", "198.51.100.7", "0.1.0"):
        assert text in page


def test_an_unknown_robot_is_approved_under_another_name(admin, program, database):
    join(program, "02:00:00:00:51:77", 1)
    assert approve(admin, "robot-005177", 1, "lift") == 303
    assert key_of(database, "lift") == ("active", fingerprint(1))


def test_a_second_machine_with_one_mac_takes_over_only_after_a_page_that_asks(
    admin, program, database
):
    """The first goes on until then; the page names both."""
    join(program, MAC, 1)
    approve(admin, "sim1", 1)
    join(program, MAC, 2, "copy")
    page = admin.ask("GET", "/admin/pending").text
    assert "sim1 is offline, and a machine with its MAC shows a new key" in page
    question = admin.ask("GET", asked("replace", "sim1", 2)).text
    assert "is disconnected within 2 seconds" in question
    assert "copy" in question
    assert key_of(database, "sim1") == ("active", fingerprint(1))
    form = {"fingerprint": fingerprint(2)}
    assert send(admin, "/admin/pending/replace/sim1", **form).status_code == 303
    assert key_of(database, "sim1") == ("active", fingerprint(2))


def test_a_rejected_key_is_refused_until_it_may_ask_again(admin, program, database):
    """The list of rejected keys takes it back."""
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
