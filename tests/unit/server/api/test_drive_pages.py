"""A robot's drive page and buttons, as programs of its managers set them."""

from __future__ import annotations

import pytest
from api_visitor import Program
from drive_settings import DOCK, LIGHTS, audited, kept
from robotether_server.db import Database
from robotether_server.page_settings import DEFAULTS

PAGE, BUTTONS = "/robots/sim1/page", "/robots/sim1/buttons"


@pytest.fixture(autouse=True)
def _ann_manages(root: Program, ann: Program) -> None:
    assert ann
    policy = {"drive": {"publish": ["/lights"], "call": ["/dock"]}}
    assert root.ask("PATCH", "/robots/sim1", {"settings": {"policy": policy}}).status_code == 200
    assert root.ask("PUT", "/grants/ann/sim1", {"level": "manage"}).status_code < 300


def test_manager_sets_the_page(ann: Program, database: Database) -> None:
    """In place of the earlier; the answer has the defaults, too, and the rest of the settings stays."""
    answer = ann.ask("PUT", PAGE, {"kind": "holonomic", "hold_after_ms": None})
    given = {"kind": "holonomic", "hold_after_ms": None}
    assert (answer.status_code, answer.json) == (200, DEFAULTS.as_dict() | given)
    assert kept(database, "page") == given
    assert ann.ask("PUT", PAGE, {}).json == DEFAULTS.as_dict()
    assert ann.get("/robots/sim1")["settings"].keys() == {"policy"}
    was = {"was": given, "page": None}
    assert audited(database, "robot_page_set")[0] == ("ann", was)


def test_manager_sets_the_buttons(ann: Program, database: Database) -> None:
    """All of them in one list."""
    answer = ann.ask("PUT", BUTTONS, {"buttons": [LIGHTS, DOCK]})
    assert (answer.status_code, answer.json) == (200, {"buttons": [LIGHTS, DOCK]})
    assert kept(database, "buttons") == [LIGHTS, DOCK]
    assert ann.ask("PUT", BUTTONS, {"buttons": []}).json == {"buttons": []}
    assert [actor for actor, _ in audited(database, "robot_buttons_set")] == ["ann", "ann"]


@pytest.mark.parametrize(
    ("path", "body", "sentence"),
    [
        (PAGE, {"kind": "tank"}, "page.kind"),
        (PAGE, {"camera": []}, "'camera'"),
        (BUTTONS, {}, "buttons"),
        (BUTTONS, {"buttons": [{**LIGHTS, "topic": "/arm"}]}, "policy.drive.publish"),
        (BUTTONS, {"buttons": [LIGHTS, {**DOCK, "service": 1}]}, "buttons.2.service"),
    ],
)
def test_what_is_wrong_is_named(ann: Program, path: str, body: object, sentence: str) -> None:
    """By its path, and with what an admin would have to add."""
    answer = ann.ask("PUT", path, body)
    assert (answer.status_code, answer.json["code"]) == (422, "field_invalid")
    assert sentence in answer.json["detail"]


@pytest.mark.parametrize("path", [PAGE, BUTTONS])
def test_only_managers_may(root: Program, ann: Program, path: str) -> None:
    """A driver is refused, whatever is sent; a robot that cannot be seen is not there."""
    root.ask("PUT", "/grants/ann/sim1", {"level": "drive"})
    assert ann.refused("PUT", path, {"nonsense": 1}) == (403, "grant_missing")
    assert ann.refused("PUT", path.replace("sim1", "sim2"), {}) == (404, "robot_unknown")


def test_an_admin_may_not_take_a_buttons_right_away_unseen(root: Program, ann: Program) -> None:
    """The refusal names the button, which goes first."""
    ann.ask("PUT", BUTTONS, {"buttons": [DOCK]})
    answer = root.ask("PATCH", "/robots/sim1", {"settings": {"buttons": [DOCK]}})
    assert answer.status_code == 422
    assert "cannot use button 'Dock'" in answer.json["detail"]
    assert root.ask("PATCH", "/robots/sim1", {"settings": {}}).status_code == 200
