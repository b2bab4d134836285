"""What happened, as admins read it."""

from __future__ import annotations

import csv
import io
import json
import re

import pytest
from api_visitor import Program
from audited_changes import NO_CHANGE, PASSWORD, STEPS, Walk, take
from flask import Flask
from robotether_server.db import Database
from web_visitor import Browser


@pytest.fixture
def events(root: Program) -> list[dict[str, object]]:
    """Three events: sim1 gets a shell, sim2 gets one, sim1 loses it; the newest first."""
    for robot, shell in (("sim1", True), ("sim2", True), ("sim1", False)):
        root.ask("PATCH", f"/robots/{robot}", {"shell": shell})
    found: list[dict[str, object]] = root.get("/audit")["events"]
    return found


def test_events_are_chosen_and_paged(root: Program, events: list[dict[str, object]]) -> None:
    """All filters together, and on from an id."""
    assert root.get("/audit?robot=sim1&actor=root")["events"] == [events[0], events[2]]
    assert root.get(f"/audit?kind={events[0]['kind']}&robot=sim2&actor=ann")["events"] == []
    assert root.get("/audit?limit=2")["events"] == events[:2]
    assert root.get(f"/audit?before={events[1]['id']}")["events"] == [events[2]]


@pytest.mark.parametrize(
    "query",
    [
        "limit=0",
        "limit=501",
        "limit=x",
        "before=0",
        "before=99999999999999999999",
        "robots=sim1",
        "robot=",
        f"kind={'x' * 41}",
        "robot=sim1&robot=sim2",
    ],
)
def test_wrong_query_is_refused(root: Program, query: str) -> None:
    """A filter that nobody reads would show more than was asked for."""
    assert root.refused("GET", f"/audit?{query}") == (422, "field_invalid")


def test_events_are_chosen_by_moment(root: Program, events: list[dict[str, object]]) -> None:
    """From one on, and before another, which must have its offset."""
    assert events
    assert len(root.get("/audit?since=2020-01-01T00:00:00Z")["events"]) >= len(events)
    assert root.get("/audit?until=2020-01-01T00:00:00Z")["events"] == []
    assert root.get("/audit?since=2100-01-01T01:00:00%2B01:00")["events"] == []
    assert root.refused("GET", "/audit?since=2026-01-31") == (422, "field_invalid")


def test_events_are_a_file_too(root: Program, events: list[dict[str, object]]) -> None:
    """The same objects a line, or the same columns; all that fit, unless a limit is asked for."""
    answer = root.ask("GET", "/audit?format=jsonl")
    assert answer.content_type == "application/jsonl"
    assert [json.loads(line) for line in answer.text.splitlines()] == events
    assert len(root.ask("GET", "/audit?format=jsonl&limit=1").text.splitlines()) == 1
    answer = root.ask("GET", f"/audit?format=csv&before={events[0]['id']}&robot=sim1")
    assert answer.content_type == "text/csv; charset=utf-8"
    (row,) = csv.DictReader(io.StringIO(answer.text))
    assert (row["id"], row["robot"], row["kind"]) == (
        str(events[2]["id"]),
        "sim1",
        events[2]["kind"],
    )
    assert json.loads(row["details"]) == events[2]["details"]
    assert root.refused("GET", "/audit?format=pdf") == (422, "field_invalid")


def test_claimed_name_is_no_formula(program: Browser, root: Program) -> None:
    """Whoever fails to log in chooses a name, which a spreadsheet must not run."""
    csrf = program.csrf()
    form = {"csrf_token": csrf, "name": "=cmd()", "password": "x", "next": ""}
    assert program.ask("POST", "/login", data=form).status_code in {400, 401, 403, 422}
    assert ",=cmd()" not in root.ask("GET", "/audit?format=csv").text


@pytest.fixture
def walk(root: Program, ann: Program, database: Database, site_certificate: None) -> Walk:
    """All steps are taken by root; machines join without a login."""
    assert site_certificate is None
    return Walk(root, ann, database)


def test_every_change_leaves_its_line(walk: Walk) -> None:
    """By who made it; a password or a token is in none."""
    for step in STEPS:
        left = take(walk, step)
        assert step[-1] in [kind for kind, *_ in left], (step, left)
        actors = {actor for _, actor, _ in left}
        assert actors == ({"robot"} if step[1] == "/join" else {"root"}), (step, left)
    everything = json.dumps(walk.events())
    assert PASSWORD not in everything
    assert not re.search(r"\br[tj]_[A-Za-z0-9_-]{20}", everything)


def test_no_change_is_forgotten(app: Flask) -> None:
    """Whoever adds a path that changes something says here which line it leaves."""
    served = {
        (method, re.sub(r"<(?:\w+:)?(\w+)>", r"{\1}", rule.rule).removeprefix("/api/v1"))
        for rule in app.url_map.iter_rules()
        if rule.rule.startswith("/api/v1")
        for method in rule.methods or ()
        if method in {"POST", "PUT", "PATCH", "DELETE"}
    }
    assert served == {(method, template) for method, template, *_ in STEPS} | NO_CHANGE
