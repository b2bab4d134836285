"""Files of recordings: what a tool of ROS reads in them, and what is left of one when its recorder is killed."""

import resource
from types import SimpleNamespace

import pytest
from mcap.reader import make_reader
from robotether_server.db.recordings import RecordableRobot
from robotether_server.recorder.cdr import EncodingError, encoder_of
from robotether_server.recorder.channels import OWN_TOPICS, CameraWriter, channel_of
from robotether_server.recorder.mcap_file import (
    MAX_CHANNELS,
    McapFile,
    RecordedChannel,
    RecordedMessage,
    repair,
)
from robotether_server.recorder.robot_recorder import OpenRecording, RecentMessages, RobotRecorder
from robotether_server.recorder.ros_types import UnknownTypeError, type_of
from rosbags.highlevel import AnyReader
from sim_robot.graph import make_graph
from sim_robot.messages import ROS_1, ROS_2
from sim_robot.rosbridge import rosapi

CHANNEL = RecordedChannel("/count", "std_msgs/msg/UInt8", "uint8 data\n")


def count(number):
    return RecordedMessage(CHANNEL, 10**18 + number, 10**18 + number, number, b"\0\1\0\0\7")


def typedefs_of(kind, ros_version=ROS_2):
    """What the simulated robot's rosapi answers of a type."""
    graph = make_graph(ros_version)
    rosapi.offer(graph)
    [service] = [each for each in graph.services.all() if each.name == "/rosapi/message_details"]
    return service.handler({"type": kind})["typedefs"]


def read_back(tmp_path, message):
    """What rosbags reads of a message."""
    file = McapFile(tmp_path / "1.mcap")
    file.add(message)
    file.finish()
    with AnyReader([tmp_path / "1.mcap"]) as bag:
        [(connection, _, data)] = bag.messages()
        return bag.deserialize(data, connection.msgtype)


def test_a_file_that_was_cut_anywhere_is_made_whole(tmp_path):
    path = tmp_path / "1.mcap"
    file = McapFile(path)
    for number in range(12):
        file.add(count(number))
        if number % 4 == 3:
            file.end_chunk()
    file.finish()
    whole = path.read_bytes()
    for size in range(0, len(whole), 7):
        path.write_bytes(whole[:size])
        index = repair(path)
        with path.open("rb") as cut:
            messages = list(make_reader(cut, validate_crcs=True).iter_messages())
        assert [message.sequence for _, _, message in messages] == list(range(len(messages)))
        assert len(messages) == index.counts.total()
        assert len(messages) % 4 == 0


def test_a_file_of_somebody_else_is_left_alone(tmp_path):
    path = tmp_path / "1.mcap"
    path.write_bytes(b"no recording")
    assert repair(path) is None
    assert path.read_bytes() == b"no recording"


@pytest.mark.parametrize(("room", "left"), [(50_000, 3), (0, 2)])
def test_a_full_disk_leaves_a_file_that_is_whole(tmp_path, room, left):
    """What it took of a chunk goes again, and the last chunk if the end of the file finds no room otherwise."""
    file = McapFile(tmp_path / "1.mcap")
    for number in range(3):
        file.add(count(number)._replace(data=bytes(2000)))
        file.end_chunk()
    _, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    file.add(count(3)._replace(data=bytes(100_000)))
    resource.setrlimit(resource.RLIMIT_FSIZE, (file.size + room, most))
    try:
        with pytest.raises(OSError, match="File too large"):
            file.end_chunk()
        file.finish()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
    with (tmp_path / "1.mcap").open("rb") as whole:
        reader = make_reader(whole, validate_crcs=True)
        numbers = [message.sequence for _, _, message in reader.iter_messages()]
        summary = reader.get_summary()
    assert numbers == list(range(left))
    assert summary.statistics.message_count == left


@pytest.mark.parametrize("ros_version", [ROS_1, ROS_2])
def test_topics_of_either_ros_are_read_by_rosbags(tmp_path, ros_version):
    graph = make_graph(ros_version)
    kind = "sensor_msgs/LaserScan"
    fields = graph.types.fields(kind)
    message = {name: 0.25 for name, field_type in fields if field_type == "float32"}
    message["header"] = graph.types.header("laser", 5_000_000_006, 1)
    message |= {"ranges": [1.5, None], "intensities": []}
    ros_type = type_of(kind, typedefs_of(kind, ros_version))
    channel = channel_of("/scan", ros_type)
    scan = read_back(tmp_path, RecordedMessage(channel, 1, 1, 0, encoder_of(ros_type)(message)))
    assert (scan.header.stamp.sec, scan.header.stamp.nanosec) == (5, 6)
    assert scan.header.frame_id == "laser"
    assert scan.ranges[0] == 1.5
    assert scan.ranges[1] != scan.ranges[1]


@pytest.mark.parametrize("codec", ["jpeg", "h264"])
@pytest.mark.parametrize(
    ("size", "taken_ns"), [(1, 9_000_000_010), (2, -1), (3, 2**62), (4, 0), (5, 0)]
)
def test_frames_are_read_by_rosbags(tmp_path, codec, size, taken_ns):
    """What follows is aligned, whatever their size; when a frame was taken is the robot's word."""
    writer = CameraWriter("/camera", codec)
    message = writer.message(b"x" * size, log_ns=1, taken_ns=taken_ns, sequence=2)
    frame = read_back(tmp_path, message)
    assert (bytes(frame.data), frame.format) == (b"x" * size, codec)


def test_a_robot_with_new_topics_all_the_time_keeps_no_command_out(tmp_path):
    """What finds no room is counted, and the file says from when on."""
    robot = RobotRecorder(None, RecordableRobot(1, "sim1"), tmp_path)
    recording = OpenRecording(1, McapFile(tmp_path / "1.mcap"), 0)
    robot.recordings[1] = recording
    for number in range(2 * MAX_CHANNELS):
        robot.write(count(0)._replace(channel=CHANNEL._replace(topic=f"/{number}")))
    command = OWN_TOPICS["commands"].channel
    robot.write(count(0)._replace(channel=command))
    recording.file.finish()
    with (tmp_path / "1.mcap").open("rb") as file:
        topics = [channel.topic for _, channel, _ in make_reader(file).iter_messages()]
    assert len(topics) == MAX_CHANNELS + 2
    assert topics[MAX_CHANNELS:] == ["/robotether/left_out", command.topic]
    progress = recording.progress()
    assert progress.messages_left_out == MAX_CHANNELS
    assert progress.topics_left_out == tuple(f"/{MAX_CHANNELS + n}" for n in range(50))


def test_the_file_of_a_stop_begins_with_what_the_robot_sent_once_before(tmp_path):
    """What came within the last seconds keeps its time."""
    robot = RobotRecorder(None, RecordableRobot(1, "sim1"), tmp_path)
    robot._observing, robot._recent = object(), RecentMessages()
    robot._observer = SimpleNamespace(lasting=lambda: [count(0), count(7)])
    for number in (5, 7):
        robot.write(count(number))
    robot.begin(1, with_recent=True)
    robot.end(1)
    with (tmp_path / "1.mcap").open("rb") as file:
        messages = [message for _, _, message in make_reader(file).iter_messages()]
    times = [(message.sequence, message.log_time % 10**18) for message in messages]
    assert times == [(0, 5), (5, 5), (7, 7)]


def test_what_waits_for_a_stop_is_bounded():
    recent = RecentMessages()
    for second in range(40):
        recent.add(count(0)._replace(log_ns=second * 10**9))
    assert [message.log_ns // 10**9 for message in recent.all()] == list(range(9, 40))
    # Also when the clock is set back.
    recent.add(count(0)._replace(log_ns=-3600 * 10**9))
    assert len(recent.all()) == 1
    recent.max_bytes = 5000
    recent.add(count(0)._replace(log_ns=40 * 10**9, data=bytes(4000)))
    assert len(recent.all()) < 10
    recent.add(count(0)._replace(log_ns=41 * 10**9, data=bytes(5000)))
    assert recent.all() == []
    # Each takes memory, whatever is in it.
    for _ in range(100):
        recent.add(count(0)._replace(log_ns=42 * 10**9, data=b""))
    assert len(recent.all()) < 50


def test_what_waits_for_a_stop_begins_with_who_drove():
    """A message of it comes at changes alone, so the newest may be older than all that is kept."""
    control = count(0)._replace(channel=OWN_TOPICS["control"].channel, log_ns=0)
    recent = RecentMessages()
    for message in (control, count(0)._replace(log_ns=40 * 10**9)):
        recent.add(message)
    assert [(each.channel, each.log_ns) for each in recent.all()] == [
        (control.channel, 40 * 10**9),
        (CHANNEL, 40 * 10**9),
    ]


def typedef(name, *types, length=-1):
    """A type with one field, as rosapi tells of it."""
    return {"type": "a/B", "fieldnames": [name], "fieldtypes": [*types], "fieldarraylen": [length]}


@pytest.mark.parametrize(
    "typedefs",
    [
        None,
        [typedef("x", "a/B")],
        [typedef("x\ny", "int8")],
        [typedef("x", "../C")],
        [typedef("x")],
        [typedef("x", "int8[9999999]", length=0)],
        [typedef("x", f"int8[{'9' * 5000}]")],
        [
            {"type": f"a/{name}", "fieldnames": ["x"] * 1000, "fieldtypes": ["int8"] * 1000}
            | {"fieldarraylen": [-1] * 1000}
            for name in "BCD"
        ],
        [
            {"type": "a/B", "fieldnames": ["x" * 127] * 1000, "fieldtypes": ["int8"] * 1000}
            | {"fieldarraylen": [-1] * 1000}
        ],
    ],
    ids=["none", "itself", "line", "path", "few", "long", "digits", "many", "much"],
)
def test_a_hostile_robots_types_are_refused(typedefs):
    with pytest.raises(UnknownTypeError):
        type_of("a/B", typedefs)


def test_a_type_that_is_reached_in_many_ways_is_read_once():
    """Two types on each of 90 levels, each of both on the next: 2 ** 90 ways, for which no recording waits."""
    typedefs = [
        {
            "type": f"a/{kind}{level}",
            "fieldnames": ["x", "y"],
            "fieldtypes": [f"a/B{level + 1}", f"a/C{level + 1}"] if level < 89 else ["int8"] * 2,
            "fieldarraylen": [-1, -1],
        }
        for level in range(90)
        for kind in "BC"
    ]
    assert len(type_of("a/B0", typedefs).definition().split("MSG: ")) == 179


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        *(
            ("uint8", message)
            for message in ({}, [], *({"data": data} for data in ("no base64", 300, [1], {})))
        ),
        # What is none is no false.
        *(("bool", {"data": data}) for data in (None, "false", [True, None])),
    ],
)
def test_a_message_of_another_type_is_refused(kind, message):
    length = 2 if message == {"data": [True, None]} else -1
    ros_type = type_of("a/B", [typedef("data", kind, length=length)])
    with pytest.raises(EncodingError):
        encoder_of(ros_type)(message)


@pytest.mark.parametrize(("text", "octet"), [("2", 2), ("AQ==", 1), ("ÿ", 255)])
def test_a_byte_may_come_as_text(text, octet):
    encode = encoder_of(type_of("a/B", [typedef("data", "byte")]))
    assert encode({"data": text})[-1] == octet
