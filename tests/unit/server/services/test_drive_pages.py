"""What a robot's managers set of its drive page, without the web."""

import pytest
from robotether_server.db import audit, robots
from robotether_server.db.audit import Source
from robotether_server.problems import FieldInvalidError, NotPossibleError
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


def test_page_and_buttons_leave_each_other_alone(site, database):
    assert site
    with database.transaction() as tx:
        robot_service.set_settings(tx, MAY, "sim1", {"guard": {"deadman_ms": 400}})
        drive_pages.set_page(tx, MAY, "sim1", {"fps": 10})
        assert drive_pages.set_buttons(tx, MAY, "sim1", []).page.fps == 10
        assert robots.get(tx, "sim1").settings == {
            "guard": {"deadman_ms": 400},
            "page": {"fps": 10.0},
        }
        drive_pages.change_page(
            tx, MAY, "sim1", lambda present: {**present, "guard": {}, "page": {"fps": 20}}
        )
        assert robots.get(tx, "sim1").settings == {
            "guard": {"deadman_ms": 400},
            "page": {"fps": 20.0},
        }
        drive_pages.change_page(tx, MAY, "sim1", lambda _: {})
        assert robots.get(tx, "sim1").settings == {"guard": {"deadman_ms": 400}}
    assert kinds(database).count("robot_page_set") == 3


def test_a_place_is_that_of_a_name():
    """Somebody else may have moved them."""
    buttons = [parse_one({**WAVE, "name": name}) for name in ("a", "b")]
    assert drive_pages.index_of(buttons, 2, "b") == 1
    for place, name in ((1, "b"), (0, "b"), (3, "b"), (-1, "a")):
        with pytest.raises(NotPossibleError, match="have changed meanwhile"):
            drive_pages.index_of(buttons, place, name)


@pytest.mark.parametrize("text", ["{", "[]", "1", "{} x", '{"a": 1, "a": 2}', "[" * 5000, "\x00"])
def test_what_is_no_json_object_is_refused(text):
    """The refusal says where the JSON goes wrong."""
    with pytest.raises(FieldInvalidError, match="cannot read what the button sends"):
        drive_pages.read(text)


def test_nothing_is_an_empty_object():
    """Most services take no arguments."""
    assert drive_pages.read("") == {}
    assert drive_pages.read('{"data": true}') == {"data": True}
