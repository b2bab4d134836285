"""Recordings: who sees what, plays, stops, downloads and deletes."""

import json
import re

import pytest
from admin_visitor import send
from granted import give
from relay_server import cell_settings
from robotether_server.db import cells, recordings, robots, users
from robotether_server.db.recordings import Progress
from robotether_server.times import utc_now
from web_visitor import audit_kinds


@pytest.fixture
def number(app, database, recorder_database):
    """Ann's recording of sim1, which goes on; olga manages the robot."""
    assert app
    with database.transaction() as tx:
        ann, robot = users.get(tx, "ann"), robots.get(tx, "sim1")
        give(tx, users.get(tx, "olga").id, robot.id, "manage")
        number = recordings.ask(tx, robot.id, robot.name, ann)
    with recorder_database.transaction() as tx:
        recordings.begin(tx, number, "main", utc_now())
        recordings.write_progress(tx, number, Progress(2_000_000, 10, ("ann",), 12, ("/<b>",)))
    return number


def test_a_recording_is_drawn_of_what_the_settings_name(browser, number, database):
    with database.transaction() as tx:
        page = {"scan_topic": "/front/scan", "cameras": [{"topic": "/rear", "name": "Rear"}]}
        robots.set_settings(tx, robots.get(tx, "sim1").id, {"page": page})
        # Also when that robot has another name by now, and another robot has its name.
        robots.rename(tx, robots.get(tx, "sim1").id, "sim9")
        robots.rename(tx, robots.get(tx, "sim2").id, "sim1")
    browser.log_in("olga")
    page = browser.ask("GET", f"/recordings/{number}").text
    [topics] = re.findall(r"data-topics='([^']*)'", page)
    assert "at least for a part of the time: /&lt;b&gt;." in page
    named = {"odometry": None, "scan": "/front/scan", "map": None, "cameras": ["/rear"]}
    assert json.loads(topics) == named
    for name in ("sim1", "sim9"):
        assert f"recording-{number}" in browser.ask("GET", f"/recordings?robot={name}").text


def test_pieces_of_a_viewing_are_one_line_of_the_audit_log(browser, app, number, database):
    """Whoever else reads the file meanwhile; a page of another viewing, or of nobody's, is a download."""

    def kinds():
        lines = audit_kinds(database)
        return [
            (kind, actor)
            for kind, actor, _ in lines
            if kind.startswith(("recording_v", "recording_do"))
        ]

    browser.log_in("olga")
    for path in (f"/recordings/{number}", f"/recordings/{number}/file"):
        assert browser.ask("HEAD", path).status_code == 200
    assert kinds() == []
    page = browser.ask("GET", f"/recordings/{number}").text
    [piece] = re.findall(r'data-file="(/recordings/\d+/file\?viewing=[^"]+)"', page)
    for _ in range(3):
        answer = browser.ask("GET", piece)
        assert answer.headers["X-Accel-Redirect"] == f"/recording-files/{number}.mcap"
    assert kinds() == [("recording_viewed", "olga")]
    browser.ask("GET", piece + "x")
    assert kinds() == [("recording_viewed", "olga"), ("recording_downloaded", "olga")]
    browser.log_in("ann")
    for path in (piece, f"/recordings/{number}"):
        assert browser.ask("GET", path).status_code == 404
    assert len(kinds()) == 2


def test_what_another_machine_has_is_played_and_downloaded_there(
    browser, number, relay_database, recorder_database
):
    with relay_database.transaction() as tx:
        cells.write_heartbeat(tx, cell_settings("b", "b.example"), cells.CellCounts(), utc_now())
    browser.log_in("olga")
    for cell, site in (("main", ""), ("b", "https://b.example")):
        with recorder_database.transaction() as tx:
            tx.change("UPDATE recordings SET cell = %s", (cell,))
        links = re.findall(
            r'href="([^"]*/recordings/\d+(?:/file)?)"', browser.ask("GET", "/recordings").text
        )
        assert links == [f"{site}/recordings/{number}/file", f"{site}/recordings/{number}"]


def test_who_drives_a_robot_sees_and_stops_a_recording(browser, number, recorder_database):
    browser.log_in("ann")
    page = browser.ask("GET", "/recordings?robot=sim1").text
    assert f"recording-{number}" in page
    assert "asked by ann" in page
    assert "2.0 MB" in page
    assert "/&lt;b&gt;" in page
    assert f'href="/recordings/{number}/file"' not in page
    assert browser.ask("GET", f"/recordings/{number}/file").status_code == 404
    assert send(browser, f"/recordings/{number}/delete").status_code == 404
    assert send(browser, f"/recordings/{number}/stop").status_code == 303
    with recorder_database.transaction() as tx:
        tx.change("UPDATE recordings SET progress_at = progress_at - INTERVAL 1 MINUTE")
    assert "unknown: its recorder is silent" in browser.ask("GET", "/recordings").text
    assert "Nothing matches." in browser.ask("GET", "/recordings?robot=sim2").text
