"""The form for a robot's policy and guard."""

from __future__ import annotations

import html
import re
from collections.abc import Mapping

import pytest
from admin_visitor import send
from robotether_server.db import Database, audit, robots
from robotether_server.robot_settings import DEFAULTS
from robotether_server.web.admin.robot_setting_fields import SECTIONS
from web_visitor import Browser

PATH = "/admin/robots/sim1/settings"


def kept(database: Database) -> dict[str, object]:
    """What is in the database."""
    with database.transaction() as tx:
        return robots.get(tx, "sim1").settings


def filled(browser: Browser) -> dict[str, str]:
    """The form as a browser would send it, unchanged."""
    page = browser.ask("GET", PATH).text
    inputs = re.findall(r'<input id="([\w.]+)" name="[\w.]+" value="([^"]*)"', page)
    areas = re.findall(r'<textarea id="([\w.]+)"[^>]*>\n([^<]*)</textarea>', page)
    return {name: html.unescape(text).replace("\n", "\r\n") for name, text in [*inputs, *areas]}


def test_form_has_every_setting_with_what_is_in_force(admin: Browser) -> None:
    """Sent back as it is, it changes nothing: only what differs from the defaults is kept."""
    form = filled(admin)
    assert form["guard.deadman_ms"] == "500"
    assert form["guard.drive_topics"] == "/cmd_vel\r\n*/cmd_vel"
    assert form["guard.max_speed_m_s"] == ""
    assert form["policy.manage.serve"] == "*"
    settings = DEFAULTS.as_dict()
    paths = set(leaves({name: settings[name] for name in ("guard", "policy")}))
    assert set(form) == paths
    assert {field.path for section in SECTIONS for field in section.fields} == paths


def leaves(settings: Mapping[str, object], above: str = "") -> list[str]:
    """The paths of all single settings."""
    found = []
    for name, value in settings.items():
        inner = isinstance(value, Mapping)
        found += leaves(value, f"{above}{name}.") if inner else [above + name]
    return found


def test_nothing_changed_is_nothing_kept(admin: Browser, database: Database) -> None:
    """Not even in the log."""
    assert send(admin, PATH, **filled(admin)).status_code == 303
    assert kept(database) == {}
    with database.transaction() as tx:
        assert audit.find(tx, audit.AuditSearch(kind="robot_settings_set")) == []


def test_changes_are_kept_with_what_they_were(admin: Browser, database: Database) -> None:
    """The shell user stays; the robot's page names them; the log has both."""
    send(admin, "/admin/robots/sim1/shell-user", shell_user="pi")
    form = filled(admin) | {
        "guard.max_speed_m_s": "0.5",
        "guard.deadman_ms": "300",
        "policy.drive.call": " /arm/*\r\n\r\n/lamp ",
        "policy.observe.subscribe": "",
    }
    answer = send(admin, PATH, **form)
    assert (answer.status_code, answer.location) == (303, "/admin/robots/sim1")
    expected = {
        "shell_user": "pi",
        "guard": {"max_speed_m_s": 0.5, "deadman_ms": 300},
        "policy": {"drive": {"call": ["/arm/*", "/lamp"]}, "observe": {"subscribe": []}},
    }
    assert kept(database) == expected
    page = admin.ask("GET", "/admin/robots/sim1").text
    for text in ("Top speed (m/s)", "0.5", "/arm/*, /lamp", "Observers: Subscribe to"):
        assert text in page
    assert filled(admin)["guard.max_speed_m_s"] == "0.5"
    with database.transaction() as tx:
        (event, *_) = audit.find(tx, audit.AuditSearch(kind="robot_settings_set"))
    assert event.details == {"was": {"shell_user": "pi"}, "settings": expected}


@pytest.mark.parametrize(
    ("path", "text"),
    [
        ("guard.deadman_ms", "100"),
        ("guard.deadman_ms", ""),
        ("guard.deadman_ms", "half a second"),
        ("guard.max_speed_m_s", "0;5"),
        ("guard.max_speed_m_s", "nan"),
        ("guard.max_speed_m_s", "-1"),
        ("guard.drive_topics", ""),
        ("guard.drive_topics", "cmd_vel"),
        ("policy.drive.publish", "/a\n/b c"),
        ("policy.limits.message_kb", "1.5"),
    ],
)
def test_wrong_setting_is_named_and_the_form_comes_back(
    admin: Browser, database: Database, path: str, text: str
) -> None:
    """As it was filled in; nothing is kept."""
    answer = send(admin, PATH, **(filled(admin) | {path: text, "guard.max_turn_rad_s": "1.25"}))
    assert answer.status_code == 422
    assert f"cannot use {path}" in html.unescape(answer.text)
    assert 'value="1.25"' in answer.text
    assert kept(database) == {}


def test_field_that_is_missing_means_nothing(admin: Browser, database: Database) -> None:
    """A form that was cut short must not lift a limit."""
    form = filled(admin)
    del form["guard.max_speed_m_s"]
    assert send(admin, PATH, **form).status_code == 422
    assert kept(database) == {}


def test_defaults_come_back_after_a_question(admin: Browser, database: Database) -> None:
    """All but the shell user."""
    send(admin, "/admin/robots/sim1/shell-user", shell_user="pi")
    send(admin, PATH, **(filled(admin) | {"guard.deadman_ms": "300"}))
    assert "the audit log keeps what they were" in admin.ask("GET", PATH + "/defaults").text
    assert "guard" in kept(database)
    assert send(admin, PATH + "/defaults").location == "/admin/robots/sim1"
    assert kept(database) == {"shell_user": "pi"}


def test_what_somebody_wrote_by_sql_can_be_mended(admin: Browser, database: Database) -> None:
    """The page says what is wrong, and the form brings the robot back."""
    with database.transaction() as tx:
        robots.set_settings(tx, robots.get(tx, "sim1").id, {"guard": {"deadman_ms": 5}})
    assert "guard.deadman_ms" in admin.ask("GET", "/admin/robots/sim1").text
    page = admin.ask("GET", PATH)
    assert (page.status_code, "form-problem" in page.text) == (200, True)
    assert send(admin, PATH, **filled(admin)).status_code == 303
    assert kept(database) == {}
