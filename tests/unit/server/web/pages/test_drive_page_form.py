"""The form for a robot's drive page."""

from __future__ import annotations

import re
from typing import get_args

import pytest
from admin_visitor import send
from drive_settings import SETTINGS, audited, filled, kept, problem_of
from robotether_server.db import Database
from robotether_server.page_settings import DEFAULTS, MAX_CAMERAS, DriveType, Kind, PageSettings
from robotether_server.web.pages.drive_page_form import FIELDS, KIND_WORDS, TYPE_WORDS
from web_visitor import Browser


def test_nothing_changed_is_nothing_kept(manager: Browser, database: Database) -> None:
    """What is in force is sent back as it is, and not even the log has it."""
    form = filled(manager)
    assert (form["kind"], form["fps"], form["hold"]) == ("differential", "15", "yes")
    assert send(manager, SETTINGS, **form).status_code == 303
    assert kept(database, "page") is None
    assert audited(database, "robot_page_set") == []


def test_manager_sets_the_page(manager: Browser, database: Database) -> None:
    """In numbers, names and cameras; rows without a word are left out; the form shows it afterwards."""
    form = filled(manager) | {
        "kind": "ackermann",
        "wheelbase_m": "0.32",
        "drive_topic": "/cmd_vel",
        "drive_type": "geometry_msgs/TwistStamped",
        "quality_max": "60",
        "topic": ["", "/rear/image_raw"],
        "name": ["", "Rear"],
        "turned_deg": ["0", "180"],
    }
    answer = send(manager, SETTINGS, **form)
    assert (answer.status_code, answer.location) == (303, SETTINGS)
    page = {
        "kind": "ackermann",
        "wheelbase_m": 0.32,
        "drive_topic": "/cmd_vel",
        "drive_type": "geometry_msgs/TwistStamped",
        "quality_max": 60,
        "cameras": [{"topic": "/rear/image_raw", "name": "Rear", "turned_deg": 180}],
    }
    assert kept(database, "page") == page
    assert audited(database, "robot_page_set") == [("may", {"was": None, "page": page})]
    again = filled(manager)
    assert again["topic"] == ["/rear/image_raw", "", ""]
    assert send(manager, SETTINGS, **again).status_code == 303
    assert kept(database, "page") == page
    assert len(audited(database, "robot_page_set")) == 1


def test_holding_is_switched_off_only_by_its_box(manager: Browser, database: Database) -> None:
    """An empty number is a mistake; without the box driving goes on whatever the picture."""
    form = filled(manager)
    answer = send(manager, SETTINGS, **form | {"hold_after_ms": ""})
    assert answer.status_code == 422
    assert "cannot use page.hold_after_ms" in problem_of(answer.text)
    del form["hold"]
    assert send(manager, SETTINGS, **form).status_code == 303
    assert kept(database, "page") == {"hold_after_ms": None}
    assert "hold" not in filled(manager)
    assert send(manager, SETTINGS, **filled(manager) | {"hold": "yes"}).status_code == 303
    assert kept(database, "page") is None


def test_browser_asks_only_for_what_may_not_be_empty(manager: Browser) -> None:
    """Else nobody could leave a topic to the page."""
    inputs = re.findall(r'<input id="page-(\w+)"[^>]*>', manager.ask("GET", SETTINGS).text)
    required = re.findall(
        r'<input id="page-(\w+)"[^>]* required[^>]*>', manager.ask("GET", SETTINGS).text
    )
    assert {field.name for field in FIELDS} < set(inputs)
    assert set(required) == {field.name for field in FIELDS if not field.empty}


@pytest.mark.parametrize(
    ("field", "text", "sentence"),
    [
        ("fps", "fast", "cannot use page.fps: it must be a number from 0.1 to 60"),
        ("fps", "", "cannot use page.fps"),
        ("quality_min", "90", "page.quality_min: 90 is over page.quality_max"),
        ("width", "640", "page.width: give width and height"),
        ("drive_topic", "/wheels", "an admin adds it to guard.drive_topics"),
        ("kind", "tank", "cannot use page.kind"),
        ("drive_type", "geometry_msgs/Pose", "cannot use page.drive_type"),
        ("scan_topic", "x" * 301, "page.scan_topic: it is missing or too long"),
        ("max_speed_m_s", "-1", "cannot use page.max_speed_m_s"),
        ("name", "Front", "cannot use page.cameras.1.topic"),
    ],
)
def test_what_is_wrong_is_named_and_kept_in_the_form(
    *, manager: Browser, database: Database, field: str, text: str, sentence: str
) -> None:
    """Nothing is changed meanwhile."""
    answer = send(manager, SETTINGS, **filled(manager) | {field: text})
    assert answer.status_code == 422
    assert sentence in problem_of(answer.text)
    assert kept(database, "page") is None
    if field in ("fps", "max_speed_m_s") and text:
        assert f'value="{text}"' in answer.text


def test_there_is_room_for_as_many_cameras_as_may_be(manager: Browser) -> None:
    """And for no more."""
    topics = [f"/camera_{number}" for number in range(MAX_CAMERAS)]
    form = filled(manager) | {"topic": topics, "name": ["x"] * len(topics)}
    assert send(manager, SETTINGS, **form | {"turned_deg": ["0"] * len(topics)}).status_code == 303
    assert filled(manager)["topic"] == topics


def test_settings_that_nobody_may_set_are_told(manager: Browser, database: Database) -> None:
    """What somebody wrote by SQL outside the page's part is for an admin to mend."""
    with database.transaction() as tx:
        tx.change("""UPDATE robots SET settings = '{"guard": {"deadman_ms": 1}}'""")
    answer = manager.ask("GET", SETTINGS)
    assert answer.status_code == 200
    assert "cannot use guard.deadman_ms" in problem_of(answer.text)
    assert send(manager, SETTINGS, **filled(manager)).status_code == 422


@pytest.mark.parametrize("path", ["", "/buttons/new", "/buttons/1", "/buttons/1/remove"])
def test_only_managers_have_the_forms(browser: Browser, manager: Browser, path: str) -> None:
    """Ann may drive sim1 and not see sim2; nobody is sent to log in; may manages sim1."""
    assert browser.ask("GET", SETTINGS + path).status_code == 302
    browser.log_in("ann")
    assert browser.ask("GET", SETTINGS + path).status_code == 403
    assert browser.ask("GET", f"/robots/sim2/settings{path}").status_code == 404
    assert send(browser, SETTINGS + path, kind="holonomic").status_code == 403
    assert manager.ask("GET", f"/robots/sim2/settings{path}").status_code == 404


def test_drive_page_leads_managers_to_it(browser: Browser, manager: Browser) -> None:
    """And nobody else."""
    link = f'href="{SETTINGS}"'
    assert link in manager.ask("GET", "/robots/sim1").text
    browser.log_in("ann")
    assert link not in browser.ask("GET", "/robots/sim1").text


def test_every_member_of_the_page_has_a_field() -> None:
    """The four others have controls of their own kinds."""
    own = {"kind", "drive_type", "cameras", "hold_after_ms"}
    assert {field.name for field in FIELDS} == set(PageSettings.__struct_fields__) - own
    assert tuple(kind for kind, _ in KIND_WORDS) == get_args(Kind)
    assert tuple(one for one, _ in TYPE_WORDS) == ("", *get_args(DriveType))


def test_what_may_be_empty_says_what_that_means() -> None:
    """And nothing else may be."""
    empty = {field.name for field in FIELDS if field.empty}
    assert empty == {
        name for name in PageSettings.__struct_fields__ if getattr(DEFAULTS, name) is None
    } - {"drive_type"}
