"""The page of routes; the API's are in transcripts/test_rest.py."""

from granted import give
from robotether_server.db import robots, routes, users


def sent(browser, start, end):
    form = {"csrf_token": browser.csrf_of("/routes"), "from": start, "to": end, "rate_hz": "20"}
    return browser.ask("POST", "/routes", data=form, follow_redirects=True)


def test_markup_is_text_everywhere(manager, database):
    """A robot names its topics and types itself."""
    with database.transaction() as tx:
        give(tx, users.get(tx, "may").id, robots.get(tx, "sim2").id, "manage")
    page = sent(manager, "sim1 /a <b>x</b>", "sim2 /a <b>x</b>").text
    assert "<code>/a</code>" in page
    wrong = sent(manager, "sim1 /<script>x</script> t", "sim2 /a t").text
    assert "<script>x" not in wrong
    assert "it must be a topic" in wrong


def test_a_robot_that_has_got_the_name_gets_no_route(manager, database):
    with database.transaction() as tx:
        give(tx, users.get(tx, "may").id, robots.get(tx, "sim2").id, "manage")
        mac = robots.get(tx, "sim1").mac
    assert "another robot has this name now" in sent(manager, "sim1 /a t", f"sim2 /a t {mac}").text
    assert "is made" in sent(manager, f"sim1 /a t {mac}", "sim2 /a t").text


def test_an_app_may_spell_a_type_as_the_other_ros_does(manager, database):
    with database.transaction() as tx:
        give(tx, users.get(tx, "may").id, robots.get(tx, "sim2").id, "manage")
    page = sent(manager, "app:joy /a std_msgs/String", "sim1 /a std_msgs/msg/String").text
    assert "is made" in page
    with database.transaction() as tx:
        assert [route.type for route in routes.list_all(tx)] == ["std_msgs/msg/String"]
    wrong = sent(manager, "sim1 /a std_msgs/String", "sim2 /a std_msgs/msg/String").text
    assert "has the type" in wrong
