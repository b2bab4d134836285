"""The tabs of a robot's settings."""

import html
import json
import math
import re

import pytest
from admin_visitor import send
from drive_settings import (
    CAMERAS,
    DRIVING,
    HELP,
    PERMISSIONS,
    SETTINGS,
    audited,
    filled,
    kept,
    problem_of,
)
from robotether_server.db import robots

FORMS = (SETTINGS, CAMERAS, DRIVING, PERMISSIONS, HELP)
OF_ADMINS = (SETTINGS, PERMISSIONS, HELP, f"{SETTINGS}/defaults")
CHANGES = {
    SETTINGS: {"guard.deadman_ms": "300"},
    CAMERAS: {"page.fps": "7,5"},
    DRIVING: {"page.kind": "holonomic"},
    PERMISSIONS: {"policy.drive.call": " /arm/*\r\n\r\n/lamp ", "policy.observe.subscribe": ""},
    HELP: {"help.geofence": "0 0\r\n9,5 0\r\n9.5 9"},
}
CHANGED = {
    "guard": {"deadman_ms": 300},
    "page": {"fps": 7.5, "kind": "holonomic"},
    "policy": {"drive": {"call": ["/arm/*", "/lamp"]}, "observe": {"subscribe": []}},
    "help": {"geofence": [[0, 0], [9.5, 0], [9.5, 9]]},
}


def all_kept(database):
    with database.transaction() as tx:
        return robots.get(tx, "sim1").settings


def write(database, settings):
    with database.transaction() as tx:
        tx.change("UPDATE robots SET settings = %s WHERE name = 'sim1'", (settings,))


def wrong(page):
    """The sentences at wrong fields, by the fields' ids; each field says that it is wrong."""
    found = re.findall(r'<p class="wrong" id="([^"]+)-problem">([^<]*)</p>', page)
    for id_, _ in found:
        assert re.search(f'id="{re.escape(id_)}"[^>]* aria-invalid="true"', page)
    return {id_: html.unescape(sentence) for id_, sentence in found}


def test_safety_and_permissions_stay_the_admins(manager, database):
    assert manager.ask("GET", SETTINGS).location == CAMERAS
    before = all_kept(database)
    for path in OF_ADMINS:
        assert send(manager, path, **CHANGES.get(path, {})).status_code == 403
        assert path == SETTINGS or manager.ask("GET", path).status_code == 403
    assert all_kept(database) == before


def test_only_managers_have_the_forms(browser, manager):
    browser.log_in("ann")
    for path in (
        *FORMS,
        *(f"{SETTINGS}/buttons{item}" for item in ("", "/new", "/1", "/1/remove")),
    ):
        elsewhere = path.replace("sim1", "sim2")
        assert browser.ask("GET", path).status_code == 403
        assert browser.ask("GET", elsewhere).status_code == 404
        if not path.endswith("/buttons"):
            assert send(browser, path, **{"page.kind": "holonomic"}).status_code == 403
        assert manager.ask("GET", elsewhere).status_code == 404


@pytest.mark.parametrize("order", [FORMS, FORMS[::-1]], ids=["forth", "back"])
def test_a_tab_saves_its_own_settings(admin, database, order):
    """However old its form is: what others saved meanwhile stays, whichever of two is saved first."""
    opened = {path: filled(admin, path) | CHANGES[path] for path in FORMS}
    for path in order:
        assert send(admin, path, **opened[path]).status_code == 303
    assert all_kept(database) == CHANGED
    # What is in force is sent back as it is, and not even the log has it.
    for path in FORMS:
        assert send(admin, path, **filled(admin, path)).status_code == 303
    assert all_kept(database) == CHANGED
    changes = [audited(database, kind) for kind in ("robot_settings_set", "robot_page_set")]
    assert [len(events) for events in changes] == [3, 2]
    page = admin.ask("GET", "/admin/robots/sim1").text
    for text in ("Stop if no command arrives for (ms)", "300", "/arm/*, /lamp"):
        assert text in page


def test_a_tab_saves_only_what_was_changed_in_it(admin, database):
    """An old form lifts no limit that another admin has set meanwhile; nor does one that had a mistake at first."""
    old = filled(admin, SETTINGS)
    limits = {"guard.max_speed_m_s": "0.3", "guard.drive_topics": "/cmd_vel"}
    send(admin, SETTINGS, **old | limits)
    mistaken = send(admin, SETTINGS, **old | {"guard.deadman_ms": "1"})
    assert f'name="was" value="{old["was"]}"' in mistaken.text
    assert send(admin, SETTINGS, **old | {"guard.deadman_ms": "300"}).status_code == 303
    guard = {"max_speed_m_s": 0.3, "drive_topics": ["/cmd_vel"], "deadman_ms": 300}
    assert kept(database, "guard") == guard
    cameras = filled(admin, CAMERAS)
    rear = {"topic": ["/rear"], "name": ["Rear"], "turned_deg": ["0"]}
    send(admin, CAMERAS, **cameras | rear)
    send(admin, CAMERAS, **cameras | {"page.fps": "10"})
    page = {"cameras": [{"topic": "/rear", "name": "Rear", "turned_deg": 0}], "fps": 10}
    assert kept(database, "page") == page
    # What is changed back is changed.
    send(admin, SETTINGS, **filled(admin, SETTINGS) | {"guard.max_speed_m_s": ""})
    del guard["max_speed_m_s"]
    assert kept(database, "guard") == guard


def test_holding_is_switched_off_only_by_its_box(manager, database):
    """An empty number is a mistake; without the box driving goes on whatever the picture."""
    form = filled(manager, DRIVING)
    assert form["page.hold_after_ms.on"] == "yes"
    answer = send(manager, DRIVING, **form | {"page.hold_after_ms": ""})
    assert answer.status_code == 422
    assert "page.hold_after_ms" in wrong(answer.text)
    del form["page.hold_after_ms.on"]
    assert send(manager, DRIVING, **form).status_code == 303
    assert kept(database, "page") == {"hold_after_ms": None}
    without = filled(manager, DRIVING)
    assert "page.hold_after_ms.on" not in without
    assert without["page.hold_after_ms"] == "1000"
    assert send(manager, DRIVING, **without | {"page.hold_after_ms.on": "yes"}).status_code == 303
    assert kept(database, "page") is None


WRONG = (
    (SETTINGS, "guard.deadman_ms", "1,000", "Enter a whole number from 200 to 2000."),
    (SETTINGS, "guard.max_speed_m_s", "0;5", "Enter a number from 0.001 to 100, or leave it empty."),
    (SETTINGS, "guard.drive_topics", "", "It must name at least one topic."),
    (CAMERAS, "page.quality_min", "90", "90 is over the highest quality"),
    (DRIVING, "page.drive_topic", "/wheels", "an admin adds it to guard.drive_topics"),
    (DRIVING, "page.kind", "tank", "Choose one of ackermann, differential, holonomic."),
)  # fmt: skip


def test_what_is_wrong_is_said_at_its_field(admin, database):
    for path, field, text, sentence in WRONG:
        answer = send(admin, path, **filled(admin, path) | {field: text})
        assert answer.status_code == 422
        found = wrong(answer.text)
        assert list(found) == [field]
        assert sentence in found[field]
        assert f'<a href="#{field}">' in answer.text
        assert filled_is(answer.text, field, text)
    assert all_kept(database) == {}


def filled_is(page, field, text):
    """Whether the field has what was typed; a choice that there is not cannot have it."""
    found = re.search(f'<(input|textarea|select) id="{re.escape(field)}"[^>]*>([^<]*)', page)
    assert found, page
    shown = html.unescape(found[0])
    return found[1] == "select" or f'value="{text}"' in shown or shown.endswith(f">\n{text}")


def test_angles_are_typed_in_degrees_and_kept_in_radians(admin, database):
    write(database, '{"guard": {"max_turn_rad_s": 1.23456789}}')
    form = filled(admin, SETTINGS)
    assert form["guard.max_turn_rad_s"] == "70.736"
    assert "Robot's turn limit: 70.736." in html.unescape(admin.ask("GET", DRIVING).text)
    send(admin, SETTINGS, **form | {"guard.max_steering_rad": "45"})
    guard = all_kept(database)["guard"]
    assert guard == {"max_turn_rad_s": 1.23456789, "max_steering_rad": math.pi / 4}


def test_field_that_is_missing_means_nothing(admin, database):
    """A form that was cut short must not lift a limit."""
    for path in FORMS:
        form = filled(admin, path)
        for field in [name for name in form if "." in name and not name.endswith(".on")]:
            cut = {name: value for name, value in form.items() if name != field}
            assert send(admin, path, **cut).status_code == 422, field
    assert all_kept(database) == {}


def test_defaults_come_back_after_a_question(admin, database):
    write(database, json.dumps({"shell_user": "pi", **CHANGED}))
    defaults = f"{SETTINGS}/defaults"
    # A robot from before that limit has none until then.
    question = admin.ask("GET", defaults).text
    assert "the slower it drives (0.25 m and 30 degrees unseen)" in question
    assert all_kept(database) == {"shell_user": "pi", **CHANGED}
    assert send(admin, defaults).location == SETTINGS
    others = {name: CHANGED[name] for name in ("page", "help")}
    assert all_kept(database) == {"shell_user": "pi", **others}


def test_what_somebody_wrote_by_sql_can_be_mended(admin, database):
    """The tab shows it and what is wrong with it; what is not a setting at all goes."""
    write(database, '{"guard": {"deadman_ms": 5}, "page": {"fps": 10}}')
    assert "guard.deadman_ms" in admin.ask("GET", "/admin/robots/sim1").text
    page = admin.ask("GET", SETTINGS)
    assert page.status_code == 200
    assert list(wrong(page.text)) == ["guard.deadman_ms"]
    form = filled(admin, SETTINGS)
    assert form["guard.deadman_ms"] == "5"
    assert send(admin, SETTINGS, **form).status_code == 422
    assert send(admin, SETTINGS, **form | {"guard.deadman_ms": "500"}).status_code == 303
    assert all_kept(database) == {"page": {"fps": 10}}
    write(database, '{"guard": {"brakes": 1}}')
    assert "'brakes' is not a setting" in problem_of(admin.ask("GET", SETTINGS).text)
    assert send(admin, SETTINGS, **filled(admin, SETTINGS)).status_code == 303
    write(database, '{"page": {"cameras": ["/front", {"name": "Rear"}], "fps": {}, "wings": 2}}')
    rows = filled(admin, CAMERAS)
    assert (rows["topic"], rows["name"]) == (["", "", ""], ["Rear", "", ""])
