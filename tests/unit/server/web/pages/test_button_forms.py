"""The forms for a robot's buttons."""

import pytest
from admin_visitor import send
from drive_settings import (
    BUTTONS,
    DOCK,
    DOCK_FORM,
    LIGHTS,
    LIGHTS_FORM,
    audited,
    kept,
    names,
    problem_of,
)
from robotether_server.db import robots

NEW = f"{BUTTONS}/new"


@pytest.fixture
def two(manager):
    for form in (LIGHTS_FORM, DOCK_FORM):
        assert send(manager, NEW, **form).location == BUTTONS


@pytest.mark.usefixtures("two")
def test_button_is_changed_where_it_stands_moved_and_removed_after_a_question(manager, database):
    path = f"{BUTTONS}/1"
    page = manager.ask("GET", path).text
    assert 'value="Lights on"' in page
    assert "&#34;data&#34;: true" in page
    send(manager, path, was="Lights on", **LIGHTS_FORM)
    assert len(audited(database, "robot_buttons_set")) == 2
    changed = LIGHTS_FORM | {"name": "Lights off", "sends": '{"data": false}', "confirm": "yes"}
    assert send(manager, path, was="Lights on", **changed).status_code == 303
    off = LIGHTS | {"name": "Lights off", "msg": {"data": False}, "confirm": True}
    assert kept(database, "buttons") == [off, DOCK]
    for number, name, to, status in ((2, "Dock", "up", 303), (1, "Dock", "up", 409)):
        assert send(manager, f"{BUTTONS}/{number}/move", was=name, to=to).status_code == status
        assert names(database) == ["Dock", "Lights off"]
    remove = f"{BUTTONS}/1/remove"
    assert 'name="was" value="Dock"' in manager.ask("GET", remove).text
    assert send(manager, remove, was="Dock").status_code == 303
    assert names(database) == ["Lights off"]


@pytest.mark.usefixtures("two")
def test_a_form_of_before_changes_no_other_button(manager, database):
    send(manager, f"{BUTTONS}/1/move", was="Lights on", to="down")
    for path, form in (("1", LIGHTS_FORM), ("1/remove", {}), ("1/move", {"to": "down"})):
        sent = form | {"was": "Lights on"}
        answer = send(manager, f"{BUTTONS}/{path}", **sent)
        assert answer.status_code == 409
        assert "have changed meanwhile" in answer.text
    assert names(database) == ["Dock", "Lights on"]
    assert manager.ask("GET", f"{BUTTONS}/3").status_code == 409
    for path in ("", "/new", "/1", "/1/remove"):
        assert 'name="meant"' in manager.ask("GET", BUTTONS + path).text, path
    # Nor one of another robot, which has got the name meanwhile.
    for path, was in (("new", ""), ("1", "Dock"), ("1/remove", "Dock"), ("1/move", "Dock")):
        sent = LIGHTS_FORM | {"name": "New", "was": was, "to": "down", "meant": "02:00:00:00:00:99"}
        answer = send(manager, f"{BUTTONS}/{path}", **sent)
        assert "what has this name now is another one" in answer.text, path
    assert names(database) == ["Dock", "Lights on"]


def test_what_is_wrong_is_named_and_kept_in_the_form(manager, database):
    for changes, sentence in (
        ({"sends": "{data: true}"}, "at line 1, column 2"),
        ({"sends": '{"data": NaN}'}, "Sends: JSON has no NaN"),
        ({"sends": '{"data": 1, "data": 2}'}, "A member appears twice"),
        ({"sends": "[" * 5000}, "Sends: "),
        ({"sends": "[]"}, "a JSON object"),
        ({"target": "lights"}, "Topic or service: Enter a full name"),
        ({"target": "/arm"}, "an admin adds it to policy.drive.publish, or the button goes"),
    ):
        answer = send(manager, NEW, **LIGHTS_FORM | changes)
        assert answer.status_code == 422
        assert sentence in problem_of(answer.text)
        assert 'value="std_msgs/Bool"' in answer.text
    assert names(database) == []


def test_admin_lets_drivers_send_it_in_the_same_step(*, admin, manager, database):
    """Both are saved or neither: on a drive topic there is no button, whatever is allowed."""
    form = LIGHTS_FORM | {"target": "/arm/wave", "allow": "yes"}
    assert 'name="allow"' not in manager.ask("GET", NEW).text
    assert send(manager, NEW, **form).status_code == 422
    assert 'name="allow"' in admin.ask("GET", NEW).text
    assert send(admin, NEW, **form | {"target": "/cmd_vel"}).status_code == 422
    assert audited(database, "robot_settings_set") == []
    assert send(admin, NEW, **form).status_code == 303
    assert names(database) == ["Lights on"]
    with database.transaction() as tx:
        policy = robots.get(tx, "sim1").settings["policy"]
    assert policy["drive"]["publish"] == ["/lights", "/arm/wave"]
    assert [actor for actor, _ in audited(database, "robot_settings_set")] == ["root"]
    assert send(admin, NEW, **DOCK_FORM | {"allow": "yes"}).status_code == 303
    assert len(audited(database, "robot_settings_set")) == 1


def test_no_button_before_broken_settings_are_corrected(manager, database):
    with database.transaction() as tx:
        tx.change("""UPDATE robots SET settings = '{"guard": {"deadman_ms": 1}}'""")
    assert "Cannot use guard.deadman_ms" in problem_of(manager.ask("GET", BUTTONS).text)
    for answer in (manager.ask("GET", NEW), send(manager, NEW, **LIGHTS_FORM)):
        assert answer.status_code == 409
        assert "until an admin has corrected its settings: cannot use guard" in answer.text
