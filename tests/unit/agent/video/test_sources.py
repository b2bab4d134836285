"""Frames from real sockets: web_video_server, cameras by URL, rosbridge; which of them is asked, how they are read."""

import asyncio
import base64
import io
import time
from dataclasses import astuple, dataclass, field, replace
from typing import Any

import aiohttp
import pytest
from fake_cameras import FakeVideoServer, fake_jpeg, number_of
from fake_cloud import eventually
from fake_rosbridge import FakeRosbridge
from h264_frames import encoded_frames
from local_network import free_port
from PIL import Image
from robotether_agent.clock import robot_time
from robotether_agent.rosbridge import RosGraph
from robotether_agent.video import sources as sources_module
from robotether_agent.video.jpeg import jpeg_size
from robotether_agent.video.sources import (
    CameraFrame,
    SourceDownError,
    SourceRequest,
    Sources,
    SourceSettings,
    camera_http,
)
from robotether_agent.video.timestamps import (
    MAX_LAG_S,
    NEAR_S,
    ClockReadings,
    FrameClock,
    FramesLateError,
    stamp_of,
    timestamp_of,
)
from robotether_common.codecs import H264

ARRIVED = ClockReadings(robot_s=1000.0, wall_s=1_800_000_000.0, steady_s=900.0)
REQUEST = SourceRequest("/camera/image_raw", 70, None, None, 15.0)
IMAGES = {"/camera/image_raw/compressed": "sensor_msgs/msg/CompressedImage"}


@pytest.mark.parametrize(
    ("stamp_s", "age_s", "is_stamped"),
    [
        (ARRIVED.wall_s - 0.25, 0.25, True),
        # Newer servers for ROS 2 write CLOCK_MONOTONIC, which stands still while the robot sleeps.
        (ARRIVED.steady_s - 0.25, 0.25, False),
        # None, simulated time, another machine's clock, and what is yet to come.
        (None, 0, False),
        (0.0, 0, False),
        (12.5, 0, False),
        (ARRIVED.wall_s - NEAR_S - 1, 0, False),
        (ARRIVED.wall_s + 0.5, 0, False),
        (ARRIVED.steady_s + 1, 0, False),
    ],
)
def test_what_a_cameras_stamp_says(stamp_s, age_s, is_stamped):
    assert timestamp_of(stamp_s, ARRIVED) == (ARRIVED.robot_s - age_s, is_stamped)


@pytest.mark.parametrize(
    ("max_lag_s", "late_s"), [(MAX_LAG_S, 1.6), (MAX_LAG_S, 9.0), (NEAR_S, NEAR_S + 1)]
)
def test_frames_that_queue_on_the_way_are_given_up_before_they_look_new(max_lag_s, late_s):
    """Without that, a frame that is older than stamps may be would count as one of now."""
    clock = FrameClock(max_lag_s)
    for age_s in (0.6, 0.5, 1.4):
        assert clock.timestamp(ARRIVED.wall_s - age_s, ARRIVED, b"")[1]
    with pytest.raises(FramesLateError):
        clock.timestamp(ARRIVED.wall_s - late_s, ARRIVED, b"")


@pytest.mark.parametrize("age_s", [0.2, NEAR_S + 1])
def test_a_frame_that_is_published_again_gets_no_younger(age_s):
    """A node whose camera is dead may do that for ever: after NEAR_S its stamp would be another clock's."""
    clock, stamp_s = FrameClock(), ARRIVED.wall_s - age_s
    taken = clock.timestamp(stamp_s, ARRIVED, b"frame")
    for later_s in (NEAR_S / 2, 2 * NEAR_S):
        later = ClockReadings(*(reading + later_s for reading in astuple(ARRIVED)))
        assert clock.timestamp(stamp_s, later, b"frame") == taken


def test_a_camera_that_always_gives_the_same_stamp_is_live():
    clock, later = FrameClock(), replace(ARRIVED, robot_s=ARRIVED.robot_s + 1)
    for frame, arrived in ((b"1", ARRIVED), (b"2", later)):
        assert clock.timestamp(5.0, arrived, frame) == (arrived.robot_s, False)


@dataclass
class Taken:
    pictures: list[CameraFrame] = field(default_factory=list)
    kinds: list[str] = field(default_factory=list)
    sources: Any = None

    def some(self, count=3):
        return lambda: len(self.pictures) >= count

    def describe(self):
        return f"{len(self.pictures)} pictures, {self.kinds}"


@pytest.fixture
async def http():
    async with camera_http() as session:
        yield session


@pytest.fixture
def run(http, make_graph, spawn):
    """Runs sources."""
    made = {}

    def start(source_settings, source_request=REQUEST):
        taken = Taken()
        if (key := repr(source_settings)) not in made:
            graph = make_graph(source_settings.rosbridge_url)
            made[key] = Sources(http, source_settings, graph)
        taken.sources = made[key]
        running = made[key].run(source_request, taken.pictures.append, taken.kinds.append)
        return spawn(running), taken

    return start


async def fails(running, why):
    with pytest.raises(SourceDownError, match=why):
        await asyncio.wait_for(running, 5)


def source_settings(video="", rosbridge="", source="auto", **cameras):
    nothing = f"127.0.0.1:{free_port()}"
    return SourceSettings(
        video or f"http://{nothing}", rosbridge or f"ws://{nothing}", source, cameras
    )


def image(number, **more):
    data = base64.b64encode(fake_jpeg(number)).decode()
    return {"header": {"stamp": {"sec": 0, "nanosec": 0}}, "format": "jpeg", "data": data, **more}


@pytest.mark.parametrize("names_length", [True, False])
async def test_frames_of_web_video_server(run, names_length):
    async with FakeVideoServer() as server:
        server.names_length = names_length
        server.stamp = lambda: time.time() - 0.5
        running, taken = run(source_settings(server.url))
        await eventually(taken.some(), taken.describe)
        numbers = [number_of(frame.data) for frame in taken.pictures]
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
        newest = taken.pictures[-1]
        assert newest.is_stamped
        assert newest.arrived_s - newest.timestamp_s == pytest.approx(0.5, abs=0.1)
        assert newest.arrived_s <= robot_time()
        assert (taken.kinds, server.asked[0]["quality"]) == (["web_video_server"], "70")
        server.stamp = lambda: time.time() - NEAR_S - 1
        await fails(running, "later than they did")


@pytest.mark.usefixtures("no_pyav", "early_stall")
@pytest.mark.parametrize(
    ("mode", "source", "topics", "why"),
    [
        ("ends", "auto", {}, "no frames from /camera/image_raw: the topic does not exist"),
        ("silent", "auto", {}, "no frames from /camera/image_raw: the topic does not exist"),
        ("lists", "auto", {}, "cannot be shown: it sends text/html"),
        # A server that answers badly is not left for rosbridge.
        ("refuses", "auto", IMAGES, "HTTP status 500"),
        ("ends", "web_video_server", IMAGES, "/compressed has only compressed images"),
        (
            "ends",
            "auto",
            {REQUEST.topic: "theora_image_transport/Packet"},
            "messages of theora_image_",
        ),
        ("ends", "rosbridge", {"/odom": "nav_msgs/Odometry"}, "has no images of /camera/image_raw"),
        ("ends", "rosbridge", {REQUEST.topic: "sensor_msgs/Image"}, "PyAV is not .*install-video"),
    ],
)
async def test_what_cannot_be_shown_is_named(run, mode, source, topics, why):
    async with FakeVideoServer(mode) as server, FakeRosbridge(topics) as rosbridge:
        running, _ = run(source_settings(server.url, rosbridge.url, source))
        await fails(running, why)


@pytest.mark.parametrize(("host", "is_followed"), [("127.0.0.1", True), ("localhost", False)])
async def test_a_camera_redirects_to_its_own_host_alone(run, host, is_followed):
    async with FakeVideoServer() as other, FakeVideoServer() as camera:
        camera.redirects_to = f"{other.url}/stream".replace("127.0.0.1", host)
        given = source_settings(rear=f"{camera.url}/stream")
        running, taken = run(given, SourceRequest("rear", 0, None, None, 15))
        if is_followed:
            await eventually(taken.some(), taken.describe)
        else:
            await fails(running, "camera rear cannot be shown: it redirects to another host")
        assert bool(other.asked) == is_followed


async def test_an_error_tells_no_password(run):
    given = source_settings(rear=f"http://ann:secret@127.0.0.1:{free_port()}/")
    running, _ = run(given, SourceRequest("rear", 0, None, None, 15))
    with pytest.raises(SourceDownError) as caught:
        await asyncio.wait_for(running, 5)
    assert "secret" not in str(caught.value) + repr(given)


async def test_frames_of_rosbridge(run):
    async with FakeRosbridge(IMAGES) as rosbridge:
        running, taken = run(source_settings(rosbridge=rosbridge.url, source="rosbridge"))
        topic = "/camera/image_raw/compressed"
        subscription = await rosbridge.subscription(topic)
        assert subscription["queue_length"] == 1
        assert 0 < subscription["throttle_rate"] < 1000 / 15
        sent_s = time.time() - 0.25
        stamp = {"sec": int(sent_s), "nanosec": int(sent_s % 1 * 1e9)}
        # A driver that has no image yet sends an empty one.
        await rosbridge.publish(topic, image(6, data=""))
        await rosbridge.publish(topic, image(7, header={"stamp": stamp}))
        await eventually(taken.some(1), taken.describe)
        assert number_of(taken.pictures[0].data) == 7
        assert taken.pictures[0].is_stamped
        assert robot_time() - taken.pictures[0].timestamp_s == pytest.approx(0.25, abs=0.2)
        stamp["sec"] -= int(NEAR_S) + 1
        await rosbridge.publish(topic, image(8, header={"stamp": stamp}))
        await fails(running, "later than they did")


@pytest.mark.parametrize(
    ("topics", "asked", "follows"),
    [
        (IMAGES, "camera/image_raw", "/camera/image_raw/compressed"),
        ({"/c": "sensor_msgs/CompressedImage"}, "/c", "/c"),
        (None, "/c", "/c/compressed"),
        (None, "/c/compressed", "/c/compressed"),
    ],
)
async def test_the_topic_that_rosbridge_is_asked_for(run, monkeypatch, topics, asked, follows):
    """By name or with /compressed, as rosapi says, and as image_transport does where there is no rosapi."""
    if topics is None:
        monkeypatch.setattr("robotether_agent.rosbridge.ANSWER_WITHIN_S", 0.1)
    async with FakeRosbridge(topics) as rosbridge:
        run(
            source_settings(rosbridge=rosbridge.url, source="rosbridge"),
            SourceRequest(asked, 0, None, None, 15),
        )
        await rosbridge.subscription(follows)


async def publish_png(rosbridge, format_):
    topic = "/camera/image_raw/compressed"
    await rosbridge.subscription(topic)
    png = base64.b64encode(b"\x89PNG").decode()
    await rosbridge.publish(topic, image(1, data=png, format=format_))


@pytest.fixture
def no_pyav(monkeypatch):
    monkeypatch.setattr(sources_module, "has_pyav", lambda: False)


@pytest.fixture
def early_stall(monkeypatch):
    monkeypatch.setattr(sources_module, "SERVER_STALL_S", 0.2)


RAW = {REQUEST.topic: "sensor_msgs/Image"}


def raw_image(**changes):
    data = base64.b64encode((5000).to_bytes(2, "little") * 8).decode()
    return {
        "width": 4,
        "height": 2,
        "step": 8,
        "encoding": "16UC1",
        "is_bigendian": 0,
        "data": data,
        **changes,
    }


async def shows_raw(rosbridge, taken, subscriptions=1):
    """One image each: of more, a busy machine delays some, which ends the source as late."""
    for number in range(1, subscriptions + 1):
        await rosbridge.subscription(REQUEST.topic, number)
        stamp = {"sec": int(time.time()), "nanosec": 0}
        await rosbridge.publish(REQUEST.topic, raw_image(width=0, height=0, data=""))
        await rosbridge.publish(REQUEST.topic, raw_image(header={"stamp": stamp}))
    await eventually(taken.some(1), taken.describe)
    picture = taken.pictures[0]
    assert Image.open(io.BytesIO(picture.data)).convert("L").getpixel((2, 1)) == 143
    assert picture.is_stamped
    assert 0 <= picture.arrived_s - picture.timestamp_s <= NEAR_S
    assert taken.kinds[-1] == "rosbridge"


@pytest.mark.parametrize("topics", [RAW, RAW | IMAGES])
async def test_raw_images_of_rosbridge(run, topics):
    """They are shown where there are no others, or no JPEGs: image_transport makes PNGs of distances."""
    async with FakeRosbridge(topics) as rosbridge:
        given = source_settings(rosbridge=rosbridge.url, source="rosbridge")
        running, taken = run(given)
        if topics != RAW:
            await publish_png(rosbridge, "16UC1; png compressed")
            await fails(running, "format '16UC1; png compressed', not JPEG")
            _, taken = run(given)
        await shows_raw(rosbridge, taken)


@pytest.mark.usefixtures("no_pyav")
async def test_images_that_are_no_jpegs_name_what_would_show_the_raw_ones(run):
    async with FakeRosbridge(RAW | IMAGES) as rosbridge:
        running, _ = run(source_settings(rosbridge=rosbridge.url, source="rosbridge"))
        await publish_png(rosbridge, "png")
        await fails(running, "not JPEG; PyAV is not installed .*install-video")


async def test_raw_images_that_web_video_server_cannot_convert_come_from_rosbridge(run):
    async with FakeVideoServer("ends") as server, FakeRosbridge(RAW) as rosbridge:
        rosbridge.publishers = ["/depth"]
        _, taken = run(source_settings(server.url, rosbridge.url))
        # The first one asks for the encoding.
        await shows_raw(rosbridge, taken, subscriptions=2)
        assert taken.kinds == ["web_video_server", "rosbridge"]
        # Another quality or size would only start another process.
        assert not taken.sources.steps_quality(REQUEST.topic)


@pytest.fixture
def early_doubt(monkeypatch):
    monkeypatch.setattr(sources_module, "FIRST_FRAME_S", 0.05)


@pytest.mark.usefixtures("early_doubt")
@pytest.mark.parametrize("mode", ["ends", "silent"])
@pytest.mark.parametrize(
    ("topics", "wanted", "follows"),
    [
        (IMAGES, REQUEST.topic, "/camera/image_raw/compressed"),
        # Somebody waits for raw images, so that the topic is there.
        (
            {REQUEST.topic: "sensor_msgs/Image", **IMAGES},
            REQUEST.topic,
            f"{REQUEST.topic}/compressed",
        ),
        ({"/c": "sensor_msgs/CompressedImage"}, "c", "/c"),
    ],
)
async def test_a_camera_that_has_compressed_images_alone_comes_from_rosbridge(
    run, mode, topics, wanted, follows
):
    async with FakeVideoServer(mode) as server, FakeRosbridge(topics) as rosbridge:
        rosbridge.publishers = []
        request = SourceRequest(wanted, 70, None, None, 15.0)
        for times in (1, 2):
            running, taken = run(source_settings(server.url, rosbridge.url), request)
            await rosbridge.subscription(follows, times)
            await rosbridge.publish(follows, image(times))
            await eventually(taken.some(1), taken.describe)
            running.cancel()
        assert (taken.kinds, len(server.asked)) == (["rosbridge"], 1)


@pytest.mark.usefixtures("no_pyav")
@pytest.mark.parametrize("source", ["auto", "web_video_server"])
async def test_images_that_web_video_server_cannot_convert_are_named_by_their_encoding(run, source):
    """Depth is no missing topic; rosbridge sends one such image, however often the camera is opened."""
    async with FakeVideoServer("ends") as server, FakeRosbridge(mode="stuck") as rosbridge:
        rosbridge.topics = {REQUEST.topic: "sensor_msgs/msg/Image"}
        rosbridge.publishers = ["/depth"]
        why = f"no images of {REQUEST.topic}, which have the encoding 16UC1"
        for _ in range(2):
            running, _ = run(source_settings(server.url, rosbridge.url, source))
            if not rosbridge.subscribed(REQUEST.topic):
                await rosbridge.subscription(REQUEST.topic)
                await rosbridge.publish(REQUEST.topic, {"encoding": "16UC1", "data": ""})
            await fails(running, why)
        assert len(rosbridge.subscribed(REQUEST.topic)) == 1


VIDEO = {
    "foxglove_msgs/msg/CompressedVideo": {"format": "h264"},
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket": {"encoding": "libx264;yuv420p", "flags": 1},
}


def video_message(kind, data):
    stamp = dict(zip(("sec", "nanosec"), divmod(time.time_ns(), 10**9), strict=True))
    times = {"timestamp": stamp} if "format" in VIDEO[kind] else {"header": {"stamp": stamp}}
    return {**times, **VIDEO[kind], "data": base64.b64encode(data).decode()}


@pytest.mark.usefixtures("early_doubt")
@pytest.mark.parametrize("kind", VIDEO)
async def test_h264_of_the_robot_comes_as_it_is(run, kind):
    frames = encoded_frames(3)
    async with FakeVideoServer("ends") as server, FakeRosbridge({"/v": kind}) as rosbridge:
        request = SourceRequest("/v", 80, None, None, 15.0, passes_h264=True)
        _, taken = run(source_settings(server.url, rosbridge.url), request)
        subscription = await rosbridge.subscription("/v")
        assert (subscription["throttle_rate"], subscription["queue_length"]) == (0, 0)
        for data in (b"", *(data for data, _ in frames)):
            await rosbridge.publish("/v", video_message(kind, data))
        await eventually(taken.some(3), taken.describe)
    assert [(frame.data, frame.is_key) for frame in taken.pictures] == [*frames]
    assert {(frame.codec, frame.is_stamped) for frame in taken.pictures} == {(H264, True)}


async def test_h264_of_the_robot_becomes_jpeg_for_who_decodes_nothing_else(run):
    kind = next(iter(VIDEO))
    async with FakeRosbridge({"/v": kind}) as rosbridge:
        given = source_settings(rosbridge=rosbridge.url, source="rosbridge")
        _, taken = run(given, SourceRequest("/v", 80, None, None, 15.0))
        await rosbridge.subscription("/v")
        for data, _ in encoded_frames(3):
            await rosbridge.publish("/v", video_message(kind, data))
        await eventually(taken.some(1), taken.describe)
    assert {jpeg_size(frame.data) for frame in taken.pictures} == {(64, 48)}


# An IDR slice alone, and a slice of type 1: a B frame.
IDR_ALONE, B_FRAME = b"\0\0\1\x65\x88", b"\0\0\1\x41\xa0"


@pytest.mark.parametrize(
    ("changes", "data", "why"),
    [
        ({"format": "h265"}, b"", "the format h265, not H.264"),
        ({}, None, "makes no sense"),
        ({}, b"\0\0\0\2\x65\x88", "not in Annex B"),
        ({}, B_FRAME, "has B frames"),
        ({}, IDR_ALONE, "without parameter sets"),
        ({}, B_FRAME[:4] + b"\xe0" + bytes(2 * 1024 * 1024), "a frame of 2097157 bytes"),
    ],
)
async def test_h264_that_no_viewer_could_show_at_once_is_named(run, changes, data, why):
    kind = next(iter(VIDEO))
    async with FakeRosbridge({"/v": kind}) as rosbridge:
        given = source_settings(rosbridge=rosbridge.url, source="rosbridge")
        running, _ = run(given, SourceRequest("/v", 80, None, None, 15.0, passes_h264=True))
        await rosbridge.subscription("/v")
        message = video_message(kind, data or b"") | changes
        await rosbridge.publish("/v", message | ({"data": 5} if data is None else {}))
        await fails(running, why)


@pytest.mark.parametrize(
    ("source", "has_pyav", "first"),
    [
        ("auto", False, "/r2/front"),
        ("rosbridge", False, "/r2/rear/image_raw"),
        ("rosbridge", True, "/r2/front"),
    ],
)
async def test_the_first_camera_is_this_robots(monkeypatch, source, has_pyav, first):
    monkeypatch.setattr(sources_module, "has_pyav", lambda: has_pyav)
    kinds = {"cmd_vel": "geometry_msgs/msg/Twist", "front": "sensor_msgs/msg/Image"}
    kinds["rear/image_raw/compressed"] = "sensor_msgs/msg/CompressedImage"
    topics = {f"/{robot}/{name}": kind for robot in ("r1", "r2") for name, kind in kinds.items()}
    async with aiohttp.ClientSession() as http, FakeRosbridge(topics) as rosbridge:
        graph = RosGraph(rosbridge.url)
        graph.drive_topic = "/r2/cmd_vel"
        sources = Sources(http, source_settings("", rosbridge.url, source), graph)
        assert await sources.first_camera() == first
        rosbridge.topics = {}
        assert await sources.first_camera() is None
        await rosbridge.stop()
        with pytest.raises(SourceDownError, match="rosapi does not say"):
            await sources.first_camera()


async def test_rosbridge_while_no_server_answers_and_the_server_again(run, monkeypatch):
    monkeypatch.setattr(sources_module, "RECHECK_S", 0.1)
    async with FakeRosbridge(IMAGES) as rosbridge, FakeVideoServer() as server:
        await server.stop()
        given = source_settings(server.url, rosbridge.url)
        running, taken = run(given)
        topic = "/camera/image_raw/compressed"
        await rosbridge.subscription(topic)
        await rosbridge.publish(topic, image(1))
        await eventually(taken.some(1), taken.describe)
        assert taken.kinds == ["web_video_server", "rosbridge"]
        await server.start()
        await fails(running, "answers again")
        # The other one is that of rosapi.
        await eventually(lambda: rosbridge.open == 1, lambda: f"{rosbridge.open} are open")


async def test_neither_source_is_told_with_both_reasons(run):
    running, _ = run(source_settings())
    await fails(running, r"web_video_server at .*; rosbridge at ")


def test_stamps_as_both_ros_write_them():
    for whole, part in (("sec", "nanosec"), ("secs", "nsecs")):
        assert stamp_of({"header": {"stamp": {whole: 5, part: 500_000_000}}}) == 5.5
    for stamp in ({"sec": 0, "nanosec": 0}, {"sec": 10**400, "nanosec": 0}, {"secs": "5"}, 5):
        assert stamp_of({"header": {"stamp": stamp}}) is None
    assert stamp_of({}) is stamp_of({"header": 1}) is None


@pytest.mark.parametrize("progressive", [False, True])
def test_the_size_of_a_real_jpeg(progressive):
    file = io.BytesIO()
    Image.new("RGB", (322, 98)).save(file, "JPEG", progressive=progressive, comment=b"x" * 300)
    jpeg = file.getvalue()
    filled = jpeg[:2] + b"\xff\xff" + jpeg[2:]
    assert (jpeg_size(jpeg), jpeg_size(filled)) == ((322, 98), (322, 98))


def test_what_is_cut_off_or_no_jpeg_has_none():
    whole = fake_jpeg(1, size=(640, 480))
    assert jpeg_size(whole) == (640, 480)
    assert [jpeg_size(whole[:length]) for length in range(16)] == [None] * 16
    assert jpeg_size(b"\x89PNG" + bytes(100)) is None
