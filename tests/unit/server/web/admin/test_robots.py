"""The robots' list, search and pages, and what an admin changes after a question."""

import pytest
from admin_visitor import join, send
from robotether_server.db.robots import Report, RobotRow
from robotether_server.db.seen_robots import SeenRobot
from robotether_server.web.admin.robots import RobotSearch
from web_visitor import audit_kinds

ROBOT = RobotRow(
    1, "00:1b:44:11:3a:b7", "lift-7", "active", 20000, 20001, "SHA256:x", {},
    report=Report("Turtle", "0.1.0", "198.51.100.9"),
)  # fmt: skip
SEEN = SeenRobot(ROBOT, online=True, since=None, level="manage", address="203.0.113.5")
MAC, OTHER_MAC = "02:00:00:00:51:01", "02:00:00:00:51:02"
GRANT = {"holder": "user:ann", "scope": "robot:sim1", "level": "drive"}


def test_a_robot_is_found_by_what_people_know_of_it():
    """All words and the state must fit; online is a state beside the record's own."""
    known = ("", "lift", "LIFT 7", "1b:44", "00-1B-44", "001b44", "turtle", "203.0.113", "100.9")
    assert [words for words in known if not RobotSearch(words).finds(SEEN)] == []
    assert not RobotSearch("lift crane").finds(SEEN)
    states = ("online", "active", "offline", "pending")
    found = [state for state in states if RobotSearch("", state).finds(SEEN)]
    assert found == ["online", "active"]


def test_what_an_unknown_robot_calls_itself_is_text(admin, program):
    """A host name is anybody's; it becomes no markup, on no page."""
    assert join(program, "02:00:00:00:51:77", 7, "<script>alert(1)</script>").status_code == 202
    for path in ("/admin/robots", "/admin/add-robot", "/admin/robots/robot-005177", "/admin/audit"):
        page = admin.ask("GET", path).text
        assert "&lt;script&gt;alert(1)" in page, path
        assert "<script>alert" not in page, path


def test_page_warns_of_a_rosbridge_that_its_network_reaches(admin, admin_database):
    for ended_at, exposed, warns in (
        ("NULL", "FALSE", False),
        ("NULL", "TRUE", True),
        ("NOW()", "TRUE", False),
    ):
        with admin_database.transaction() as tx:
            tx.change(
                "INSERT INTO robot_sessions (robot_id, address, ros_exposed, ended_at) "
                f"SELECT id, '', {exposed}, {ended_at} FROM robots WHERE name = 'sim1'"
            )
        page = admin.ask("GET", "/admin/robots/sim1").text
        assert ('data-testid="ros-exposed"' in page) == warns
        assert ("<code>address:=127.0.0.1</code>" in page) == warns


@pytest.mark.parametrize(
    ("page", "path"),
    [
        ("/admin/robots/sim1/disable", ""),
        ("/robots/sim1/settings", ""),
        ("/robots/sim1/settings/defaults", ""),
        ("/admin/robots/sim1", "/admin/robots/sim1/site"),
        ("/admin/robots/sim1/access", "/admin/robots/sim1/grants"),
    ],
)
def test_a_page_of_a_robot_changes_none_that_got_its_name_since(admin, database, page, path):
    send(admin, "/admin/sites", name="hall")
    assert f'name="meant" value="{MAC}"' in admin.ask("GET", page).text
    send(admin, "/admin/robots/sim1/rename", new_name="other")
    send(admin, "/admin/robots/sim2/rename", new_name="sim1")
    before = audit_kinds(database)
    answer = send(admin, path or page, meant=MAC, site="hall", **GRANT)
    assert (answer.status_code, "what has this name now is another one" in answer.text) == (
        404,
        True,
    )
    assert audit_kinds(database) == before


def test_ticks_stay_where_a_search_shows_others(admin):
    assert "None of the 2 robots matches" in admin.ask("GET", "/admin/robots?q=ghost").text
    query = {"q": "sim1", "robot": [MAC, OTHER_MAC, "02:00:00:00:51:99"]}
    page = admin.ask("GET", "/admin/robots", query_string=query).text
    assert ("row-sim1" in page, "row-sim2" in page, "1 of 2" in page) == (True, False, True)
    assert f'value="{MAC}" aria-label="Select sim1" checked' in page
    assert f'<input type="hidden" form="selected" name="robot" value="{OTHER_MAC}">' in page
    assert "2 robots ticked, 1 not shown here" in page
    assert "51:99" not in page
    query = {"robot": [f"sim{number}" for number in range(101)]}
    answer = admin.ask("GET", "/admin/selected-robots/disable", query_string=query)
    assert "tick at most 100 robots at once" in answer.text


def test_ticked_robots_are_offered_to_nobody_where_only_admins_are(admin, admin_database):
    """Its question would name nobody."""
    assert "/admin/selected-robots/grant" in admin.ask("GET", "/admin/robots").text
    with admin_database.transaction() as tx:
        tx.change("DELETE FROM users WHERE role <> 'admin'")
    assert "/admin/selected-robots/grant" not in admin.ask("GET", "/admin/robots").text


def test_a_list_of_robots_has_pages(admin, admin_database):
    with admin_database.transaction() as tx:
        for number in range(3, 62):
            tx.change(
                "INSERT INTO robots (mac, name, state, ros_port, video_port, settings) "
                "SELECT CONCAT('02:00:00:00:60:', LPAD(HEX(%s), 2, '0')), CONCAT('bot', %s), 'active', %s, %s, '{}'",
                (number, number, 40000 + 2 * number, 40001 + 2 * number),
            )
    first, second, beyond = (
        admin.ask("GET", f"/admin/robots{page}").text for page in ("", "?page=2", "?page=9")
    )
    rows = [page.count('data-testid="row-') for page in (first, second, beyond)]
    assert rows == [50, 11, 11]
    assert admin.ask("GET", "/admin/robots?state=zzz").status_code == 422
    assert 'href="/admin/robots?page=2">Next' in first
    assert 'href="/admin/robots?page=1">Previous' in second
