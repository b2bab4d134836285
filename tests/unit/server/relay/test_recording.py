"""A robot that is recorded through a real relay: what its file has, and what ends it."""

import asyncio
import contextlib
import json
import os
import struct
import threading
from dataclasses import replace

import aiohttp
import pytest
import pytest_asyncio
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader
from relay_server import MESSAGE_LIMIT, TICKET_KEY, until
from robotether_common.codecs import H264
from robotether_server.db.recordings import RecordableRobot, RecordingRow
from robotether_server.disks import DiskSpace
from robotether_server.recorder import observer, relay_client, robot_recorder, service
from robotether_server.recorder.relay_client import RelayChannel, RelayClient
from robotether_server.recorder.service import RecorderService
from robotether_server.relay.channels import recorder as channel
from robotether_server.settings.server import DatabaseSettings, RecorderSettings, TicketSettings
from robotether_server.times import utc_now
from rosbags.highlevel import AnyReader

TYPEDEFS = [
    {
        "type": "demo/Speed",
        "fieldnames": ["value"],
        "fieldtypes": ["float32"],
        "fieldarraylen": [-1],
    }
]


class MemoryStore:
    """The recordings of a database, as a test sets them."""

    def __init__(self):
        self.robots = [RecordableRobot(7, "sim1", None, ("/camera",))]
        self.rows = {}
        self.endings = []
        self.down = False
        self.free_part = None
        self.bytes_elsewhere = 0

    def ask(self, number=1):
        self.rows[number] = RecordingRow(
            number, 7, "sim1", "asked", "ann", False, False, False, None, None, None, 0, True, False
        )

    def change(self, number, **members):
        self.rows[number] = replace(self.rows[number], **members)

    async def read(self):
        return None if self.down else (list(self.rows.values()), self.robots)

    async def begin(self, row, _robot):
        self.change(row.id, started_at=utc_now())
        return True

    async def add(self, _robot, cause, started_at):
        number = len(self.rows) + 1
        self.ask(number)
        self.change(number, cause=cause, asked_by=None, started_at=started_at)
        return number

    async def write_progress(self, _progress): ...

    async def write_room(self, free_part):
        self.free_part = free_part

    async def read_bytes_elsewhere(self, _before):
        return self.bytes_elsewhere

    def end(self, ending):
        self.endings.append(ending)
        self.change(ending.id, ended_at=ending.ended_at, started_at=utc_now())

    async def note_deleted(self, number):
        del self.rows[number]

    async def read_older(self, _before):
        return []

    async def read_present(self, numbers):
        return {number for number in numbers & self.rows.keys() if self.rows[number].started_at}

    async def flush(self): ...

    def code(self, number=1):
        """Why a recording ended; empty: it did not."""
        return next((ending.code for ending in self.endings if ending.id == number), "")


@pytest.fixture
def store():
    return MemoryStore()


@pytest.fixture
def settings(tmp_path):
    database = DatabaseSettings("nowhere", 1, "none", "none", "none")
    tickets = TicketSettings(TICKET_KEY, 30)
    return RecorderSettings(
        database, tickets, "main", "127.0.0.1", tmp_path, 10**9, 0, MESSAGE_LIMIT, "info"
    )


@pytest_asyncio.fixture
async def recorder(relay, robot, settings, store, monkeypatch):
    monkeypatch.setattr(relay_client, "PUBLIC_PORT", relay.relay.http_port)
    monkeypatch.setattr(relay_client, "INSIDE_PORT", relay.relay.inside_port)
    monkeypatch.setattr(service, "STEP_S", 0.05)
    monkeypatch.setattr(service, "DISK_EVERY_S", 0.05)
    robot.frames.mode = "behaves"
    async with aiohttp.ClientSession() as session:
        recorder = RecorderService(settings, RelayClient(settings, session), store)
        working = asyncio.create_task(recorder.run())
        yield recorder
        working.cancel()
        await asyncio.gather(working, return_exceptions=True)
        await recorder.close()


async def answer_rosapi(robot, service_name, **values):
    """Answer the recorder's next call of a service of rosapi as the robot."""

    def calls():
        messages = [json.loads(text) for text in robot.received]
        return [each for each in messages if each.get("service") == f"/rosapi/{service_name}"]

    await until(calls, f"/rosapi/{service_name} is called")
    answer = {"op": "service_response", "id": calls()[-1]["id"], "values": values, "result": True}
    await robot.send_to_clients(json.dumps(answer).encode())


def file_of(settings, number=1):
    return settings.folder / f"{number}.mcap"


def messages_of(settings, number=1):
    """All that was written as a whole, also in a file that is still written, or whose recorder was killed."""
    found = []
    path = file_of(settings, number)
    if path.exists():
        with path.open("rb") as file, contextlib.suppress(McapError, struct.error):
            for _, channel, message in NonSeekingReader(file).iter_messages(log_time_order=False):
                found.append((channel.topic, message.data))
    return found


def topics_of(settings, number=1):
    return {topic for topic, _ in messages_of(settings, number)}


def fences_of(settings):
    controls = (data for topic, data in messages_of(settings) if topic == "/robotether/control")
    return [struct.unpack_from("<q", data, 28)[0] for data in controls]


def frames_of(settings):
    return [data for topic, data in messages_of(settings) if topic == "/camera/video"]


async def test_a_recorder_that_is_refused_logs_no_ticket(relay, settings, monkeypatch, caplog):
    caplog.set_level("INFO")
    monkeypatch.setattr(relay_client, "INSIDE_PORT", relay.relay.inside_port)
    stranger = replace(settings, tickets=TicketSettings("another key" * 4, 30))
    async with aiohttp.ClientSession() as session:
        channel = RelayChannel(RelayClient(stranger, session), lambda *_: None, list)
        connecting = asyncio.create_task(channel.run())
        await until(lambda: "cannot reach the relay: HTTP 401" in caplog.messages, "it is refused")
        connecting.cancel()
        await asyncio.gather(connecting, return_exceptions=True)


async def test_a_recording_has_topics_frames_and_what_the_driver_did(
    *, recorder, relay, robot, sim1, store, settings, program, monkeypatch
):
    monkeypatch.setattr(observer, "MAX_RECORDED_TOPICS", 2)
    store.ask()
    # The last is another robot's.
    topics = ["/speed", "/robotether/fake", "/cmd_vel", "/temperature", "/sim2/cmd_vel"]
    types = [*["demo/Speed"] * 4, "geometry_msgs/Twist"]
    await answer_rosapi(robot, "topics", topics=topics, types=types)
    await answer_rosapi(robot, "message_details", typedefs=TYPEDEFS)
    await until(lambda: len(robot.topics) == 2, "the topics are subscribed")
    await robot.send_to_topics(b'{"op":"publish","topic":"/speed","msg":{"value":0.5}}')
    await until(lambda: "/speed" in topics_of(settings), "it is in the file, which is open")
    await robot.send_to_topics(b'{"op":"publish","topic":"/speed","msg":{"value":"fast"}}')
    await robot.frames.wait_for("credit")
    await robot.frames.show(b"a picture")
    async with program() as driver:
        await driver.clock_sync()
        await driver.drive(0.25, seen=[{"camera": "/camera", "frame": 3}])
        await driver.drive(0.75, age_ms=2000)
        wanted = {"/camera/compressed", "/robotether/commands", "/robotether/control"}
        await until(lambda: wanted <= topics_of(settings), "all is in the file")
    describe = relay.relay.fleet_events.describe
    assert (describe(sim1).recording, describe(sim1).observers) == (True, 0)
    store.change(1, is_stop_requested=True)
    await until(lambda: store.code() == "stopped", "it ended")
    assert store.endings[0].progress.topics_left_out == ("/temperature",)
    await until(lambda: not describe(sim1).recording, "nobody records")
    messages = messages_of(settings)
    # The robot's double sends it on the connections of both topics.
    speeds = {data for topic, data in messages if topic == "/speed"}
    assert speeds == {b"\0\1\0\0" + struct.pack("<f", 0.5)}
    [picture] = [data for topic, data in messages if topic == "/camera/compressed"]
    assert picture.endswith(struct.pack("<I", 9) + b"a picture")
    assert sum(relay.relay.traffic.command_ages.counts) == 1
    with AnyReader([file_of(settings)]) as bag:
        names = {each.topic: each.msgtype for each in bag.connections}
        assert names["/speed"] == "demo/msg/Speed"
        assert sum(1 for _ in bag.messages()) == len(messages)
        commands = [
            bag.deserialize(data, connection.msgtype)
            for connection, _, data in bag.messages()
            if connection.topic == "/robotether/commands"
        ]
    outcomes = [(each.person, each.outcome) for each in commands]
    assert outcomes == [("ann", "sent"), ("ann", "too_old")]
    assert commands[0].seen_cameras == ["/camera"]


async def test_a_relay_that_is_back_says_again_who_drives(
    *, recorder, relay, store, settings, monkeypatch
):
    """The relay repeats the state after a reconnection, and after it dropped events."""
    monkeypatch.setattr(channel, "MAX_WAITING", 1)

    def was_lost(times):
        fences = fences_of(settings)
        return fences.count(-1) == times and fences[-1] == 0

    store.ask()
    await until(lambda: store.rows[1].started_at, "it began")
    relay.relay.fleet_events.end_subscriptions()
    await until(lambda: was_lost(1), "it was lost, and is back")
    for _ in range(2):
        relay.relay.registry.robot(7).recorders.send("round_trips", dict)
    await until(lambda: was_lost(2), "something was lost")


async def test_video_is_recorded_with_key_frames_and_without_gaps(
    *, recorder, relay, robot, store, settings, monkeypatch
):
    """A reader of the file begins at a key frame; nobody else may ask for one."""
    monkeypatch.setattr(observer, "KEY_FRAME_EVERY_S", 0.0)
    store.ask()
    await robot.frames.wait_for("credit")
    for number, data in enumerate((b"key", b"one", b"two")):
        await robot.frames.show(data, codec=H264.number, is_key=data == b"key")
        await until(lambda seen=number + 1: len(frames_of(settings)) == seen, "it is in the file")
    await robot.frames.wait_for("key_frame")


async def test_a_file_of_a_robot_that_is_recorded_already_lacks_nothing(
    *, recorder, robot, store, settings
):
    """The robot has sent its static frames once, and a reader needs a key frame."""
    store.robots = [replace(store.robots[0], recording_when="always")]
    topics = ["/tf_static", "/speed"]
    await answer_rosapi(robot, "topics", topics=topics, types=["demo/Speed"] * 2)
    await answer_rosapi(robot, "message_details", typedefs=TYPEDEFS)
    await until(lambda: len(robot.topics) == 2, "the topics are subscribed")
    for topic in topics:
        message = {"op": "publish", "topic": topic, "msg": {"value": 0.5}}
        await robot.send_to_topics(json.dumps(message).encode())
    await until(lambda: {*topics} <= topics_of(settings), "they are in the first file")
    await robot.frames.wait_for("credit")
    await robot.frames.show(b"key", codec=H264.number, is_key=True)
    await until(lambda: frames_of(settings), "it is in the first file")
    store.ask(2)
    await until(lambda: store.rows[2].started_at, "it began")
    await robot.frames.show(b"one", codec=H264.number)
    await robot.frames.wait_for("key_frame")
    await until(lambda: "/camera/video" in topics_of(settings, 2), "it is in the second file")
    assert topics_of(settings, 2) == {"/robotether/control", "/tf_static", "/camera/video"}


async def test_a_camera_that_the_settings_add_is_recorded_at_once(recorder, relay, store):
    store.robots = [replace(store.robots[0], recording_when="on_stop")]
    feeds = relay.relay.registry.ensure_robot(7).feeds
    for cameras in (("/camera",), ("/camera", "/rear")):
        store.robots = [replace(store.robots[0], cameras=cameras)]
        await until(lambda expected={*cameras}: {key.camera for key in feeds} == expected, "feeds")


async def test_a_recording_ends_with_the_right_of_who_asked(recorder, store, settings):
    # A file that cannot be deleted keeps no other from its end.
    store.ask(9)
    store.change(9, is_delete_requested=True, started_at=utc_now(), ended_at=utc_now())
    (settings.folder / "9.mcap").mkdir()
    ends = ({"may_go_on": False}, "right_ended"), ({"is_delete_requested": True}, "stopped")
    for number, (change, code) in enumerate(ends, 1):
        store.ask(number)
        await until(lambda at=number: store.rows[at].started_at, "it began")
        store.change(number, **change)
        await until(lambda at=number, code=code: store.code(at) == code, "it ended", within_s=2)


async def test_a_number_that_comes_again_has_a_file_of_its_own(recorder, relay, store, settings):
    """The database was replaced by an older one, which knows neither what goes on nor its file."""
    store.ask()
    await until(lambda: messages_of(settings), "it records")
    store.rows.clear()
    await until(lambda: not relay.relay.registry.robot(7).recorders, "it ended")
    former = file_of(settings).read_bytes()
    store.ask()
    await until(lambda: store.rows[1].started_at, "the other one began")
    [aside] = [path for path in settings.folder.iterdir() if path != file_of(settings)]
    assert aside.read_bytes() == former
    assert file_of(settings).read_bytes() != former
    assert not store.endings


async def test_files_that_no_record_names_are_set_aside_and_deleted_when_old(
    recorder, store, settings, monkeypatch
):
    """Another cell may record under their number."""
    monkeypatch.setattr(service, "RETENTION_EVERY_S", 0.0)
    store.ask()
    store.change(1, ended_at=utc_now(), started_at=utc_now())
    names = ("1.mcap", "2.mcap", "3-7.mcap", "4.mcap")
    for name in names:
        path = settings.folder / f"{name}.new"
        path.touch()
        if name != "4.mcap":
            os.utime(path, (0, 0))
        path.rename(settings.folder / name)
    object.__setattr__(settings, "days", 1)

    def left():
        return sorted(path.name.partition("-")[0] for path in settings.folder.iterdir())

    await until(lambda: left() == ["1.mcap", "4"], "the others are deleted")


async def test_what_may_not_begin_does_not(recorder, store, settings):
    await until(lambda: recorder.channel.is_open, "the recorder is connected")
    refusals = [
        ({"may_go_on": False}, "right_ended"),
        ({"robot_id": 8}, "robot_gone"),
        ({"is_late": True}, "robot_offline"),
    ]
    for number, (changes, code) in enumerate(refusals, 1):
        store.ask(number)
        store.change(number, **changes)
        await until(lambda at=number, code=code: store.code(at) == code, "it is refused")
    assert not list(settings.folder.glob("*.mcap"))


async def test_a_large_file_of_a_killed_recorder_delays_nobody(recorder, store, monkeypatch):
    begun, goes_on, results = threading.Event(), threading.Event(), []

    def repair(_path):
        begun.set()
        results.append(goes_on.wait(5))

    monkeypatch.setattr(service, "repair", repair)
    await until(lambda: recorder.channel.is_open, "the recorder is connected")
    store.ask()
    store.change(1, started_at=utc_now())
    await until(begun.is_set, "the file is made whole")
    store.ask(2)
    store.change(2, may_go_on=False)
    await until(lambda: store.code(2) == "right_ended", "what comes next is dealt with")
    goes_on.set()
    await until(lambda: store.code() == "recorder_restarted", "it has ended")
    assert results == [True]


@pytest.mark.parametrize("when", ["always", "driven", "on_stop"])
async def test_a_robot_is_recorded_by_its_setting(
    *, recorder, relay, robot, sim1, store, settings, when, program
):
    store.robots = [replace(store.robots[0], recording_when=when)]
    await until(lambda: relay.relay.registry.robot(7).recorders, "the recorder follows")
    if when == "on_stop":
        await until(lambda: robot.frames.of("credit"), "frames are kept")
        await robot.frames.show(b"before the stop")
        await asyncio.sleep(0.2)
        relay.relay.control.stops.stop(sim1, "ann")
    if when == "driven":
        assert not store.rows
        async with program() as driver:
            await driver.clock_sync()
            await until(lambda: store.rows, "the drive is recorded")
    await until(lambda: "/robotether/control" in topics_of(settings), "it is in a file")
    assert store.rows[1].cause == when
    if when == "on_stop":
        assert any(b"before the stop" in data for _, data in messages_of(settings))
    store.robots = [replace(store.robots[0], recording_when=None)]
    await until(lambda: store.code() == "setting_changed", "it ended")


async def test_a_recording_leaves_some_of_the_disk_free(recorder, store, monkeypatch):
    store.ask()
    await until(lambda: store.rows[1].started_at, "it began")
    monkeypatch.setattr(service, "read_space", lambda _folder: DiskSpace(4 * 10**9, 10**11))
    await until(lambda: store.free_part == 0.04, "the disk is measured")
    monkeypatch.setattr(service, "read_space", lambda _folder: DiskSpace(10**9 - 1, 10**11))
    await until(lambda: store.code() == "disk_full", "it ended")


async def test_where_no_file_can_be_written_there_is_no_room(recorder, store, monkeypatch):
    def refuse(_path):
        raise OSError("read-only file system")

    monkeypatch.setattr(robot_recorder, "McapFile", refuse)
    await until(lambda: store.free_part, "there is room")
    store.ask()
    await until(lambda: store.code() == "disk_full", "it ended")
    await until(lambda: store.free_part == 0, "there is none")


async def test_a_quota_of_the_site_that_is_reached_ends_the_recording(recorder, store, settings):
    store.ask()
    await until(lambda: store.rows[1].started_at, "it began")
    store.bytes_elsewhere = settings.max_bytes - 10**7
    await until(lambda: 0 < store.free_part < 0.02, "little is left of the quota")
    store.bytes_elsewhere = settings.max_bytes
    await until(lambda: store.code() == "quota_reached", "it ended")
    store.ask(2)
    await until(lambda: store.code(2) == "quota_reached", "no other begins")


async def test_a_recording_goes_on_while_the_database_is_away(recorder, robot, store, settings):
    store.ask()
    await until(lambda: "/robotether/control" in topics_of(settings), "it records")
    store.down = True
    await robot.frames.wait_for("credit")
    await robot.frames.show(b"a picture")
    await until(lambda: "/camera/compressed" in topics_of(settings), "it goes on")
    assert not store.endings
