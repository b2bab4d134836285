"""What a robot's managers set of its drive page, without the web."""

import pytest
from robotether_server.db import audit, robots
from robotether_server.db.audit import Source
from robotether_server.problems import FieldInvalidError
from robotether_server.services import drive_pages
from robotether_server.services import robots as robot_service
from robotether_server.settings.buttons import parse_one

MAY = Source("may", "198.51.100.7")
WAVE = {"name": "Wave", "kind": "call", "service": "/arm/wave"}


def kinds(database):
    with database.transaction() as tx:
        return [item.kind for item in reversed(audit.find(tx, audit.AuditSearch()))]


def test_a_button_needs_its_right_and_allow_gives_it(site, database):
    assert site
    with database.transaction() as tx:
        robot_service.set_settings(tx, MAY, "sim1", {"policy": {"drive": {"call": ["/dock"]}}})
    with (
        pytest.raises(FieldInvalidError, match=r"policy\.drive\.call"),
        database.transaction() as tx,
    ):
        drive_pages.set_buttons(tx, MAY, "sim1", [WAVE])
    for _ in range(2):
        with database.transaction() as tx:
            drive_pages.allow(tx, MAY, "sim1", parse_one(WAVE))
            drive_pages.set_buttons(tx, MAY, "sim1", [WAVE])
    with database.transaction() as tx:
        settings = robots.get(tx, "sim1").settings
    assert settings["policy"] == {"drive": {"call": ["/dock", "/arm/wave"]}}
    assert kinds(database)[-3:] == ["robot_settings_set", "robot_settings_set", "robot_buttons_set"]


@pytest.mark.parametrize("text", ["{", "[]", "1", "{} x", '{"a": 1, "a": 2}', "[" * 5000, "\x00"])
def test_what_is_no_json_object_is_refused(text):
    with pytest.raises(FieldInvalidError, match="cannot read what the button sends"):
        drive_pages.read(text)


def test_nothing_is_an_empty_object():
    assert drive_pages.read("") == {}
    assert drive_pages.read('{"data": true}') == {"data": True}
