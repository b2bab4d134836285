"""A receiver that decodes more than JPEG: what it gets, in which order, and when it gets JPEGs after all."""

import asyncio
import os
import sys
from contextlib import AsyncExitStack

import pytest
from fake_cameras import fake_jpeg
from fake_cloud import eventually
from openssh_server import command_line, descendants
from receiver_world import SIZE, World, unpacked
from robotether_agent.clock import robot_time
from robotether_agent.video import encoder as encoder_module
from robotether_agent.video import frame_encoder as frame_encoder_module
from robotether_agent.video.encoder import COMMAND
from robotether_agent.video.encoding import LoadSteps
from robotether_agent.video.frame_encoder import FULL, EncoderPool, FrameEncoder
from robotether_agent.video.sources import SourceRequest
from robotether_common.codecs import H264, JPEG
from robotether_common.frames import ENCODER_STARTS, StreamRequest
from video_clips import Decoder, clip, jpeg_of

HANGS = "import os, time; os.write(1, bytes(4)); time.sleep(60)"
CODECS = ["h264", "jpeg"]
# An encoder starts, on a busy machine.
STARTS_WITHIN_S = 30


@pytest.fixture(autouse=True)
def two_cores(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})


@pytest.fixture
async def make_world():
    async with AsyncExitStack() as ends:

        def make(*command, setting="auto", steps_quality=True, line_rate=None, pool=None):
            reports = []
            pool = pool or EncoderPool(
                setting, command or COMMAND, reports.append, lambda: line_rate
            )
            world = World(steps_quality=steps_quality, encoders=pool)
            world.reports = reports
            ends.push_async_callback(world.end)
            return world

        yield make


async def until_encoding(world, **fields):
    world.socket.ask("stream_request", codecs=CODECS, **fields)
    await world.until_open()
    await eventually(
        lambda: world.receiver._encoder.codec is H264,
        lambda: world.receiver._encoder.down_reason,
        STARTS_WITHIN_S,
    )


async def test_every_frame_that_goes_out_can_be_decoded_after_those_before_it(make_world):
    """Though two of three are skipped for want of credit, and the source is asked for a size alone."""
    world, decoder = make_world(), Decoder()
    await until_encoding(world, quality_max=60, width=160, height=120)
    for number, picture in enumerate(clip(30, step=2)):
        world.give_data(jpeg_of(picture))
        if number % 3 == 2:
            world.socket.ask("credit")
            await world.got((number + 1) // 3)
    headers = [unpacked(message) for message in world.socket.pictures]
    # The camera's source is opened again for its encoder, and the first frame comes from both.
    assert [header.sequence - headers[0].sequence for header in headers] == [*range(0, 30, 3)]
    assert [header.is_key for header in headers] == [True] + 9 * [False]
    assert {(header.codec, header.quality) for header in headers} == {(H264, 60)}
    for message in world.socket.pictures:
        assert decoder.decode(message[SIZE:]).shape == (120, 160, 3)
    assert world.sent == [("/camera", each.sequence, each.timestamp_ms / 1000) for each in headers]
    assert list(world.open)[-1] == SourceRequest("/camera", 90, 160, 120, 15.0, passes_h264=True)


async def test_key_frames_come_by_request_and_no_oftener_than_twice_a_second(
    make_world, monkeypatch
):
    # Another preset begins with a key frame, and a busy machine has another.
    monkeypatch.setattr(LoadSteps, "on_encoded", lambda *_: True)
    world = make_world()
    await until_encoding(world)
    for number, picture in enumerate(clip(21, step=2)):
        if number:
            # A storm of requests.
            world.socket.ask("key_frame")
        await world.pass_on(jpeg_of(picture), 0.11)
    keys = [n for n, data in enumerate(world.socket.pictures) if unpacked(data).is_key]
    assert keys == [0, 5, 10, 15, 20]


async def test_the_first_encoded_frame_has_what_a_full_line_carries(make_world):
    """JPEGs come until the encoder has started, and show the camera's size and the line."""
    world, [frame] = make_world(line_rate=110_000), map(jpeg_of, clip(1, step=2))
    world.socket.ask("stream_request", codecs=CODECS)
    await world.until_open()
    headers = [unpacked(await world.pass_on(frame))]
    await until_encoding(world)
    headers.append(unpacked(await world.pass_on(frame)))
    assert [(header.codec, header.quality) for header in headers] == [(JPEG, 80), (H264, 60)]


async def test_a_camera_that_takes_no_requests_steps_by_its_encoder(make_world):
    world = make_world(steps_quality=False)
    await until_encoding(world, quality_min=50, quality_max=60, latency_ms=100)
    decoder, shapes, qualities = Decoder(), [], []
    for picture in clip(8, step=2):
        message = await world.pass_on(jpeg_of(picture))
        shapes.append(decoder.decode(message[SIZE:]).shape[:2])
        qualities.append(unpacked(message).quality)
        await world.have_taken(0.15)
    assert qualities == 3 * [60] + 5 * [50]
    assert shapes == 6 * [(240, 320)] + 2 * [(180, 240)]
    assert list(world.open) == [SourceRequest("/camera", 0, None, None, 15.0, passes_h264=True)]


async def test_a_clock_sync_is_answered_while_a_frame_is_encoded(make_world):
    world = make_world(sys.executable, "-c", HANGS)
    await until_encoding(world)
    world.socket.ask("credit")
    world.give(1)
    await eventually(lambda: world.receiver._to_encode is not None, lambda: "it is encoded")
    world.socket.ask("clock_sync", t_ms=1.0)
    await eventually(lambda: world.socket.texts[-1]["op"] == "clock_sync", lambda: "the answer")
    assert not world.socket.pictures


async def test_without_its_encoder_a_receiver_gets_jpegs_and_the_reason(make_world, monkeypatch):
    monkeypatch.setattr(encoder_module, "ANSWER_S", 0.5)
    world = make_world(sys.executable, "-c", HANGS)
    await until_encoding(world)
    world.socket.ask("credit", frames=2)
    world.give(1)
    assert await world.got(1) == [1]
    assert unpacked(world.socket.pictures[0]).codec is JPEG
    world.now_s += 1
    world.receiver._check()
    reason = "the encoder made no frame within 0.5 s"
    await eventually(
        lambda: world.socket.texts[-1].get("no_encoder") == reason, lambda: str(world.socket.texts)
    )
    assert world.socket.texts[-1]["encoder"] is None
    await eventually(lambda: list(world.open)[-1].quality == 80, lambda: str(list(world.open)))


async def test_a_processor_that_is_too_slow_gets_fewer_frames_and_the_status_says_so(make_world):
    world = make_world()
    await until_encoding(world)
    world.receiver._encoder._load.max_fps = 5.0
    first, *later = map(jpeg_of, clip(20, step=2))
    await world.pass_on(first)
    for jpeg in later:
        world.socket.ask("credit")
        world.give_data(jpeg)
        await eventually(
            lambda: not (world.receiver._waiting or world.receiver._to_encode), lambda: "it is out"
        )
    assert 9 <= len(world.socket.pictures) <= 11
    world.receiver._check()
    reason = "the robot's processor encodes no more than 5 frames a second"
    await eventually(
        lambda: world.socket.texts[-1].get("no_encoder") == reason, lambda: str(world.socket.texts)
    )
    assert world.reports[-1] == f"libx264: {reason}"


async def test_a_frame_that_cannot_be_encoded_goes_out_as_it_came(make_world):
    world, good = make_world(), [jpeg_of(picture) for picture in clip(3, step=2)]
    await until_encoding(world)
    for jpeg in (good[0], fake_jpeg(9), good[1], good[2]):
        await world.pass_on(jpeg, 1.0)
    headers = [unpacked(message) for message in world.socket.pictures]
    assert [(header.codec, header.is_key) for header in headers] == [
        (H264, True),
        (JPEG, False),
        (H264, True),
        (H264, False),
    ]
    assert world.socket.pictures[1][SIZE:] == fake_jpeg(9)


@pytest.mark.parametrize(
    ("setting", "codecs", "reason"),
    [
        ("off", CODECS, "the setting video_encoder is off"),
        ("auto", ["jpeg"], ""),
    ],
)
async def test_no_encoder_runs_that_nobody_wants(make_world, setting, codecs, reason):
    world = make_world(setting=setting)
    world.socket.ask("stream_request", codecs=codecs)
    assert (await world.until_open()).quality == 80
    header = unpacked(await world.pass_on(fake_jpeg(1)))
    assert (header.codec, header.quality, header.is_key) == (JPEG, 80, False)
    assert world.socket.texts[0]["no_encoder"] == reason
    assert descendants(os.getpid()) == []


async def test_what_a_camera_encodes_itself_needs_no_encoder(make_world):
    world = make_world()
    await until_encoding(world)
    message = await world.pass_on(b"one access unit, as it is", codec=H264, is_key=True)
    assert message[SIZE:] == b"one access unit, as it is"
    await eventually(lambda: descendants(os.getpid()) == [], lambda: "the process ends")


async def test_the_encoder_ends_with_its_receiver_and_with_the_wish_for_jpeg(make_world):
    world = make_world()
    await until_encoding(world)
    assert len(descendants(os.getpid())) == 1
    world.socket.ask("stream_request", codecs=["jpeg"])
    await eventually(lambda: descendants(os.getpid()) == [], lambda: "the process ends")
    await until_encoding(world)
    await eventually(lambda: bool(descendants(os.getpid())), lambda: "another one runs")
    (pid,) = descendants(os.getpid())
    assert "encoder_process" in command_line(pid)
    await world.end()
    assert descendants(os.getpid()) == []


async def test_a_camera_that_yields_leaves_its_encoder_to_another(make_world, monkeypatch):
    monkeypatch.setattr(frame_encoder_module, "MAX_ENCODERS", 1)
    observed = make_world()
    driven = make_world(pool=observed.receiver._encoder._pool)
    await until_encoding(observed, yields=True)
    await until_encoding(driven)
    assert observed.receiver._encoder.down_reason == FULL
    observed.socket.ask("stream_request", codecs=CODECS, yields=False)
    await asyncio.sleep(0)
    assert driven.receiver._encoder.codec is H264
    await driven.end()
    await until_encoding(observed)


def test_encoder_that_is_installed_while_the_agent_runs_is_used(monkeypatch):
    with monkeypatch.context() as without:
        without.setattr(encoder_module, "has_pyav", lambda: False)
        pool = EncoderPool("auto")
    frame_encoder = FrameEncoder(pool, "/camera", lambda: None, robot_time)
    frame_encoder.use(StreamRequest(codecs=("h264", "jpeg")))
    assert frame_encoder.down_reason == ENCODER_STARTS
