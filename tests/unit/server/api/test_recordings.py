"""Recordings, as programs of drivers and managers ask for them, and as the recorder reads what they ask."""

from concurrent.futures import ThreadPoolExecutor

import pytest
from admin_records import events
from api_visitor import program_of
from granted import give, take
from robotether_server.db import recordings, robots, users
from robotether_server.db.recordings import Progress
from robotether_server.services import recordings as recording_service
from robotether_server.times import utc_now
from web_visitor import HASH


@pytest.fixture
def people(root, ann, program, database):
    """Ann drives sim1, ben does, too, and mia manages it; eve may drive nothing."""
    assert root
    with database.transaction() as tx:
        tx.change("UPDATE robots SET state = 'active' WHERE name = 'sim1'")
        robot = robots.get(tx, "sim1")
        added = {name: users.add(tx, name, HASH, "user") for name in ("ben", "mia", "eve")}
        give(tx, added["ben"], robot.id, "drive")
        give(tx, added["mia"], robot.id, "manage")
    return {"ann": ann} | {name: program_of(program, database, name) for name in added}


@pytest.fixture
def begun(people, recorder_database):
    """Ann's recording of sim1, which the recorder has begun."""
    recording = people["ann"].ask("POST", "/robots/sim1/recordings").json
    with recorder_database.transaction() as tx:
        assert recordings.begin(tx, recording["id"], "main", utc_now())
        recordings.write_progress(tx, recording["id"], Progress(1000, 10, ("ann", "ben")))
    return recording["id"]


def test_a_driver_records_a_robot_once(people, recorder_database):
    recording = people["ann"].ask("POST", "/robots/sim1/recordings").json
    assert (recording["state"], recording["cause"]) == ("requested", "asked")
    assert (recording["robot"], recording["asked_by"]) == ("sim1", "ann")
    assert people["ben"].refused("POST", "/robots/sim1/recordings") == (409, "not_possible")
    with recorder_database.transaction() as tx:
        [row] = recordings.read_open(tx, "main")
        assert (row.id, row.may_go_on) == (recording["id"], True)
        assert not recordings.begin(tx, row.id + 1, "main", utc_now())
        assert recordings.begin(tx, row.id, "main", utc_now())
        assert not recordings.begin(tx, row.id, "second", utc_now())
        assert recordings.read_open(tx, "second") == []


def test_a_robot_that_has_got_the_name_shows_no_recording_of_the_one_before(people, database):
    """A page that lists by the name shows, and stops, the recording of another robot; the MAC prevents that."""
    recording = people["ann"].ask("POST", "/robots/sim1/recordings").json["id"]
    mac = people["ann"].get("/robots/sim1")["mac"]
    with database.transaction() as tx:
        tx.change("UPDATE robots SET name = 'turtle' WHERE name = 'sim1'")
        tx.change("UPDATE robots SET name = 'sim1' WHERE name = 'sim2'")
        other = robots.get(tx, "sim1")
        give(tx, users.get(tx, "ann").id, other.id, "drive")

    def listed(query):
        return [each["id"] for each in people["ann"].get(f"/recordings?{query}")["recordings"]]

    assert (listed("robot=sim1"), listed(f"mac={mac}")) == ([recording], [recording])
    assert listed(f"mac={other.mac}") == []


@pytest.mark.parametrize("passed_s", [61, -120])
def test_a_request_that_nobody_took_within_a_minute_keeps_no_other_out(
    people, recorder_database, admin_database, passed_s
):
    """Only the database's clock counts, and that may have been set back: web and recorder may run on other machines."""
    assert people["ann"].ask("POST", "/robots/sim1/recordings").status_code == 201
    with admin_database.transaction() as tx:
        tx.change("UPDATE recordings SET asked_at = asked_at - INTERVAL %s SECOND", (passed_s,))
    assert people["ben"].ask("POST", "/robots/sim1/recordings").status_code == 201
    with recorder_database.transaction() as tx:
        assert [row.is_late for row in recordings.read_open(tx, "main")] == [True, False]
    states = [each["state"] for each in people["ann"].get("/recordings")["recordings"]]
    assert states == ["requested", "interrupted"]


def test_of_two_who_ask_for_a_recording_at_once_one_gets_it(people, database):
    with ThreadPoolExecutor() as pool:
        with database.transaction() as tx:
            recording_service.ask(tx, users.get(tx, "ann"), "sim1")
            second = pool.submit(people["ben"].refused, "POST", "/robots/sim1/recordings")
            with pytest.raises(TimeoutError):
                second.result(0.3)
        assert second.result(10) == (409, "not_possible")


def test_strangers_and_observers_record_nothing(people, database):
    assert people["eve"].refused("POST", "/robots/sim1/recordings") == (404, "robot_unknown")
    with database.transaction() as tx:
        give(tx, users.get(tx, "eve").id, robots.get(tx, "sim1").id, "observe")
    assert people["eve"].refused("POST", "/robots/sim1/recordings") == (403, "grant_missing")


@pytest.mark.parametrize(
    ("method", "path", "allowed"),
    [
        ("GET", "", {"ann", "ben", "mia"}),
        ("POST", "/stop", {"ann", "mia"}),
        ("GET", "/file", {"mia"}),
        ("DELETE", "", {"mia"}),
    ],
)
def test_anothers_recording_is_out_of_reach(people, begun, method, path, allowed):
    for name, program in people.items():
        if name not in allowed:
            status = program.ask(method, f"/recordings/{begun}{path}").status_code
            assert status in {403, 404}, name
    for name in allowed:
        assert people[name].ask(method, f"/recordings/{begun}{path}").status_code < 300, name


def test_a_list_has_what_the_caller_may_drive(people, begun):
    [listed] = people["ben"].get("/recordings?robot=sim1")["recordings"]
    assert (listed["id"], listed["state"], listed["bytes"]) == (begun, "recording", 1000)
    assert listed["drivers"] == ["ann", "ben"]
    assert people["ben"].get(f"/recordings?before={begun}")["recordings"] == []
    assert people["eve"].get("/recordings")["recordings"] == []
    assert people["eve"].refused("GET", "/recordings?robot=sim1") == (404, "robot_unknown")


def test_a_recording_does_not_outlive_its_right(people, begun, recorder_database, database):
    with database.transaction() as tx:
        take(tx, users.get(tx, "ann").id, robots.get(tx, "sim1").id)
    with recorder_database.transaction() as tx:
        [row] = recordings.read_open(tx, "main")
        assert not row.may_go_on
        recordings.end(tx, row.id, "right_ended", None, utc_now())
    assert people["mia"].get(f"/recordings/{begun}")["end_code"] == "right_ended"


def test_many_pieces_are_one_download_of_each_person(people, root, begun, database):
    """The file is sent by nginx, at a path that is made of its number alone."""
    before = events(database)
    assert people["mia"].ask("HEAD", f"/recordings/{begun}/file").status_code == 200
    assert events(database) == before
    for _ in range(3):
        assert root.ask("GET", f"/recordings/{begun}/file").status_code == 200
        answer = people["mia"].ask("GET", f"/recordings/{begun}/file")
    assert answer.headers["X-Accel-Redirect"] == f"/recording-files/{begun}.mcap"
    name = f"robotether-sim1-{begun}.mcap"
    assert answer.headers["Content-Disposition"] == f'attachment; filename="{name}"'
    for person in ("mia", "root"):
        assert events(database).count((person, "recording_downloaded", "sim1")) == 1
    people["mia"].ask("DELETE", f"/recordings/{begun}")
    assert ("mia", "recording_deleted", "sim1") in events(database)


def test_a_robots_setting_reaches_the_recorder(people, root, recorder_database):
    assert people
    page = {"cameras": [{"topic": topic, "name": topic} for topic in ("/a", "/b")]}
    settings = {"recording": {"when": "on_stop"}, "page": page}
    assert root.ask("PATCH", "/robots/sim1", {"settings": settings}).status_code == 200
    with recorder_database.transaction() as tx:
        found = {robot.name: robot for robot in recordings.read_robots(tx)}
    assert found["sim1"].recording_when == "on_stop"
    assert found["sim1"].cameras == ("/a", "/b")
    settings = {"recording": {"when": "sometimes"}}
    assert root.refused("PATCH", "/robots/sim1", {"settings": settings}) == (422, "field_invalid")
