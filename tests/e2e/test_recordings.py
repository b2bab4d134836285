"""Recordings of a simulated robot's drives: asked for by a driver, written by the service, downloaded by a manager."""

import json
import time
import urllib.request
from urllib.error import HTTPError

import page_holds
import pytest
from attackers import Person
from local_network import insecure_tls
from mcap.reader import make_reader
from pages import drive_live, open_drawer
from playwright.sync_api import expect
from program_driver import ProgramDriver
from robotether_server.lerobot.export import ExportOptions, export
from rosbags.highlevel import AnyReader
from sim_watch import SimWatch

ROBOT = "sim1"
WANTED = {
    "/odom": "nav_msgs/msg/Odometry",
    "/scan": "sensor_msgs/msg/LaserScan",
    "/robotether/commands": "robotether_msgs/msg/DriveCommand",
    "/robotether/control": "robotether_msgs/msg/Control",
}

# What a canvas shows, as a number.
PIXELS = """(canvas) => {
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  return data.reduce((sum, value, i) => (sum * 31 + value * (i % 7)) % 1000003, 0);
}"""


@pytest.fixture
def person(stack, request):
    """Makes somebody with a level at sim1, which is there and which nobody drives."""
    stack.wait_until_drivable(ROBOT)

    def make(name, level):
        request.addfinalizer(lambda: stack.admin.remove("users", name))
        return Person(stack, name, (ROBOT, level))

    return make


@pytest.fixture
def rhea(person):
    return person("rhea", "drive")


@pytest.fixture
def mark(person):
    return person("mark", "manage")


def file_of(person, number, piece=""):
    request = urllib.request.Request(
        f"{person.stack.url}/api/v1/recordings/{number}/file",
        headers=person.bearer | ({"Range": f"bytes={piece}"} if piece else {}),
    )
    with urllib.request.urlopen(request, context=insecure_tls(), timeout=30) as answer:
        return answer.status, answer.read()


def ask(person, method, path, status=200):
    answer = person.ask(method, f"/api/v1{path}")
    assert answer.status == status, answer
    return json.loads(answer.body or "null")


def wait_for_state(person, number, state):
    person.stack.wait(
        f"it is {state}",
        lambda: ask(person, "GET", f"/recordings/{number}")["state"] == state,
        "recorder",
        seconds=60,
    )


def test_a_drive_is_recorded_played_back_and_read_by_rosbags(page, stack, rhea, mark, tmp_path):
    """The page records and replays by keyboard; a driver gets no file, of which training data can be made."""
    number = _record(page, stack, mark)
    _replay(page, stack, number)
    lines = (
        "SELECT kind FROM audit_events WHERE kind IN ('recording_viewed', 'recording_downloaded')"
    )
    rows = stack.sql(f"{lines} AND JSON_VALUE(details, '$.recording') = {number}")
    assert [row[0] for row in rows] == ["recording_viewed"]
    ask(rhea, "GET", f"/recordings/{number}/file", 404)
    status, data = file_of(mark, number)
    assert status == 200
    assert file_of(mark, number, "8-107") == (206, data[8:108])
    with pytest.raises(HTTPError, match="416") as refused:
        file_of(mark, number, f"{len(data)}-")
    assert json.load(refused.value)["code"] == "requested_range_not_satisfiable"
    file = tmp_path / "drive.mcap"
    file.write_bytes(data)
    _expect_drive(file)
    # It refuses a recording of which no episode is left.
    export([file], tmp_path / "dataset", ExportOptions(None, (), "Drive."))
    ask(mark, "DELETE", f"/recordings/{number}", 204)
    folder = "/var/lib/robotether/recordings"
    stack.wait(
        "the file is gone",
        lambda: f"{number}.mcap" not in stack.exec("recorder", "ls", folder),
        "recorder",
    )


def _record(page, stack, mark):
    drive_live(page, stack, ROBOT)
    open_drawer(page)
    record = page.get_by_test_id("record")
    record.click()
    expect(page.get_by_test_id("record-state")).to_contain_text("Recorded since", timeout=10_000)
    expect(page.get_by_test_id("recording")).to_have_text("This drive is being recorded.")
    page.keyboard.press("Escape")
    with SimWatch(stack, ROBOT) as watch:
        page_holds.hold_key(page, lambda: _drive_on(page, watch))
        page.keyboard.up("w")
    open_drawer(page)
    record.click()
    expect(record).to_have_text("Record", timeout=10_000)
    number = int(ask(mark, "GET", f"/recordings?robot={ROBOT}")["recordings"][0]["id"])
    wait_for_state(mark, number, "ended")
    expect(page.get_by_test_id("recording")).to_be_empty()
    return number


def _drive_on(page, watch):
    """Drive for longer than the shortest episode of a dataset, without a pause."""
    watch.wait_moving()
    page.wait_for_timeout(3000)
    assert not page_holds.had_to_let_go(page)


def _replay(page, stack, number):
    page.goto(f"{stack.url}/recordings/{number}")
    video, root = page.get_by_test_id("replay-video"), page.get_by_test_id("replay")
    expect(page.get_by_test_id("clock")).to_contain_text("0:00 of")
    page.keyboard.press("ArrowRight")
    expect(video).to_have_attribute("data-frame", "live")
    expect(page.get_by_test_id("replay-words")).to_be_empty()
    expect(page.get_by_test_id("driver")).to_have_text("admin")
    later = video.locator("canvas").evaluate(PIXELS)
    # From its beginning: five seconds later a short one is over.
    page.keyboard.press("Home")
    page.keyboard.press("Space")
    expect(root).to_have_attribute("data-playing", "true")
    stack.wait("another picture", lambda: video.locator("canvas").evaluate(PIXELS) != later)
    expect(page.get_by_test_id("asked")).to_contain_text("m/s")
    expect(page.get_by_test_id("measured")).to_contain_text("m/s")
    page.keyboard.press("Space")
    expect(root).to_have_attribute("data-playing", "false")
    page.keyboard.press("End")
    expect(page.get_by_test_id("replay-words")).to_be_empty()


def _expect_drive(file):
    """Expect a whole file in which the admin's commands were sent, with what was seen."""
    with file.open("rb") as opened:
        summary = make_reader(opened, validate_crcs=True).get_summary()
    assert summary is not None
    with AnyReader([file]) as bag:
        types = {connection.topic: connection.msgtype for connection in bag.connections}
        assert types.items() >= WANTED.items()
        assert {"/camera/image_raw/compressed", "/camera/image_raw/video"} & types.keys()
        commands = [
            bag.deserialize(command, connection.msgtype)
            for connection, _, command in bag.messages()
            if connection.topic == "/robotether/commands"
        ]
    moving = [command for command in commands if command.speed_m_s > 0]
    assert {command.person for command in moving} == {"admin"}
    assert {command.outcome for command in moving} == {"sent"}
    assert any(command.seen_frames.size for command in moving)


def test_a_killed_recorder_loses_a_recording_no_more_than_a_second(stack, rhea, mark, tmp_path):
    """Its file is whole when the recorder is back, and the drive does not notice."""
    number = int(ask(rhea, "POST", f"/robots/{ROBOT}/recordings", status=201)["id"])
    wait_for_state(rhea, number, "recording")
    with ProgramDriver(rhea.program.url(ROBOT)) as driver:
        time.sleep(3)  # of which all but the last second must be there
        killed_s = time.time()
        stack.container("recorder").kill()
        stack.container("recorder").start()
        wait_for_state(rhea, number, "ended")
        assert driver.close_code is None
    file = tmp_path / "killed.mcap"
    file.write_bytes(file_of(mark, number)[1])
    with AnyReader([file]) as bag:
        assert "/odom" in bag.topics
        # It was killed after this time, and the bag's end is the next nanosecond.
        assert killed_s - bag.end_time / 1e9 < 1


def test_nobody_else_reaches_the_recorders_channel(stack):
    """It opens neither through nginx, nor inside with a user's ticket."""
    token = stack.token("channel")
    bearer = {"Authorization": f"Bearer {token}"}
    _, ticket = stack.request(
        "POST", "/api/v1/tickets", {"robot": ROBOT, "mode": "observe"}, headers=bearer
    )
    assert stack.request("GET", f"/recorder?ticket={ticket['ticket']}")[0] == 404
    assert stack.request("GET", "/recording-files/1.mcap", headers=bearer)[0] == 404
    script = (
        "import urllib.request, urllib.error\n"
        f"url = 'http://127.0.0.1:9100/recorder?ticket={ticket['ticket']}'\n"
        "try: print(urllib.request.urlopen(url).status)\n"
        "except urllib.error.HTTPError as refused: print(refused.code)\n"
    )
    assert stack.exec("relay", "python3", "-c", script).strip() == "401"
