"""One receiver, by itself: credit, what waits for it, numbers, and which sizes it asks for."""

import itertools
from random import Random

import pytest
from fake_cameras import fake_jpeg
from fake_cloud import eventually
from receiver_world import FIRST, SIZE, World, unpacked
from robotether_agent.video import shared_sources
from robotether_agent.video.receiver import FrameRateLimiter
from robotether_agent.video.sources import CameraFrame, SourceRequest
from robotether_agent.video.waiting_frames import HELD_S, MAX_WAITING, NewFrame, WaitingFrames
from robotether_common.codecs import H264, JPEG


def passed(limiter, times):
    return [number for number, at in enumerate(times) if limiter.allows(at)]


def test_a_camera_of_the_wanted_rate_loses_nothing_to_jitter():
    random = Random(1)
    times = sorted(n / 15 + random.uniform(-0.02, 0.02) for n in range(300))
    assert len(passed(FrameRateLimiter(15), times)) >= 298


@pytest.mark.parametrize(("camera", "wanted", "each"), [(30, 15, 2), (60, 15, 4), (30, 1, 30)])
def test_a_quicker_camera_is_thinned_evenly(camera, wanted, each):
    left = passed(FrameRateLimiter(wanted), [n / camera for n in range(10 * camera)])[4:]
    assert {after - before for before, after in itertools.pairwise(left)} <= {
        each,
        each + 1,
        each - 1,
    }
    assert len(left) == pytest.approx(10 * wanted, rel=0.1, abs=4)


def test_a_pause_is_not_made_up_for():
    limiter = FrameRateLimiter(15)
    assert passed(limiter, [0.0, *(10 + n / 1000 for n in range(20))]) == [0, 1, 2]


@pytest.fixture
async def world():
    made = World()
    yield made
    await made.end()


async def test_the_newest_goes_out_when_credit_comes(world):
    """What came before it is skipped, and the number tells; eight at once are the most."""
    world.socket.ask("stream_request")
    await world.until_open()
    for number in (1, 2, 3):
        world.give(number)
    world.socket.ask("credit", frames=99)
    assert await world.got(1) == [3]
    assert unpacked(world.socket.pictures[0]).sequence == FIRST + 3
    for number in range(4, 11):
        world.give(number)
        await world.got(number - 2)
    world.give(11)
    world.socket.ask("clock_sync", t_ms=1.0)
    await eventually(lambda: world.socket.texts[-1]["op"] == "clock_sync", lambda: "it is answered")
    assert world.socket.texts[-1]["sender_ms"] == world.now_s * 1000
    assert len(world.socket.pictures) == 8
    # Taking the second one takes the first.
    world.socket.ask("credit", taken=FIRST + 4)
    assert await world.got(9) == [*range(3, 12)]
    assert len(world.receiver._in_flight) == 7


async def test_each_frame_is_reported_before_it_leaves(world):
    world.socket.stuck = True
    world.socket.ask("stream_request")
    await world.until_open()
    world.give(1)
    world.give(2)
    world.socket.ask("credit")
    assert await world.got(1) == [2]
    assert world.sent == [("/camera", FIRST + 2, world.now_s)]
    assert unpacked(world.socket.pictures[0]).sequence == FIRST + 2


async def take_late(world, count):
    """Give frames of which each is taken 0.15 s later."""
    for number in range(1, count + 1):
        world.give(number)
        await world.got(number)
        await world.have_taken(0.15)


async def test_h264_of_the_robot_is_passed_on_untouched(world):
    """All frames come in order from a key frame on, at any rate; the source is not asked for another size."""
    world.socket.ask("stream_request", codecs=["h264"], fps=1)
    world.socket.ask("credit", frames=2)
    request = await world.until_open()
    assert request.passes_h264
    for number, kind in enumerate("FKFF"):
        world.give_data(b"%d%s" % (number, kind.encode()), 0.03, H264, is_key=kind == "K")
    await eventually(lambda: len(world.socket.pictures) == 2, lambda: str(world.socket.texts))
    world.socket.ask("credit", taken=FIRST + 3)
    await eventually(lambda: len(world.socket.pictures) == 3, lambda: str(world.socket.texts))
    headers = [unpacked(picture) for picture in world.socket.pictures]
    assert [(h.codec, h.is_key, h.sequence - FIRST) for h in headers] == [
        (H264, True, 2),
        (H264, False, 3),
        (H264, False, 4),
    ]
    assert [picture[SIZE:] for picture in world.socket.pictures] == [b"1K", b"2F", b"3F"]
    world.now_s += 1
    world.socket.ask("stream_request", codecs=["h264"], fps=30, quality_max=30)
    await eventually(lambda: world.socket.texts[-1].get("codec") == "h264", lambda: "its status")
    assert (world.socket.texts[-1]["encoder"], list(world.open)) == ("the camera", [request])


async def test_the_size_goes_down_when_the_quality_is_at_its_least(world):
    world.socket.ask("stream_request", quality_min=50, quality_max=50, latency_ms=100)
    world.socket.ask("credit")
    assert await world.until_open() == SourceRequest("/camera", 50, None, None, 15.0)
    await take_late(world, 3)
    await eventually(lambda: len(world.open) == 2, lambda: str(list(world.open)))
    assert list(world.open)[-1] == SourceRequest("/camera", 50, 480, 360, 15.0)


async def test_fewer_frames_than_the_camera_gives_bring_the_quality_down(world):
    """Though each comes in time: what goes out is compared with what there is once a second."""
    world.socket.ask("stream_request")
    world.socket.ask("credit")
    begun = await world.until_open()
    for second in range(1, 9):
        for _ in range(10):
            world.give(second)
        await world.got(second)
        world.receiver._check()
        if len(world.open) > 1:
            break
        await world.have_taken(0.0)
    assert list(world.open)[-1].quality < begun.quality


REQUEST = SourceRequest("/camera", 80, None, None, 15.0)


def put(waiting, kinds, *, at_s=0.0, step_s=0.0):
    """Let frames wait by their kind, a letter each: J of JPEG, K a key frame, F another one of H.264."""
    for kind in kinds:
        codec = JPEG if kind == "J" else H264
        frame = CameraFrame(kind.encode(), at_s, at_s, codec=codec, is_key=kind == "K")
        waiting.put(NewFrame(0, frame, REQUEST), at_s)
        at_s += step_s


def taken(waiting):
    frames = iter(waiting.next, None)
    return b"".join(new.frame.data for new in frames).decode()


@pytest.mark.parametrize(
    ("kinds", "sent"),
    [
        ("JJJ", "J"),
        ("KFF", "KFF"),
        # What can be decoded without them replaces those that wait.
        ("KFFKF", "KF"),
        ("FFF", ""),
        ("FFKF", "KF"),
        ("KFJ", "J"),
        ("JFF", ""),
    ],
)
def test_frames_wait_so_that_each_can_be_decoded(kinds, sent):
    waiting = WaitingFrames()
    put(waiting, kinds)
    assert taken(waiting) == sent


@pytest.mark.parametrize(("kinds", "step_s"), [("KFFF", HELD_S), ("K" + "F" * MAX_WAITING, 0.0)])
def test_frames_that_wait_too_long_leave_room_for_the_next_key_frame(kinds, step_s):
    waiting = WaitingFrames()
    put(waiting, kinds, step_s=step_s)
    assert taken(waiting) == ""
    put(waiting, "FKF", at_s=9.0)
    assert taken(waiting) == "KF"


def test_frames_of_another_request_do_not_continue_those_before():
    waiting = WaitingFrames()
    put(waiting, "KF")
    other = SourceRequest("/camera", 50, None, None, 15.0)
    waiting.put(NewFrame(0, CameraFrame(b"F", 0.0, 0.0, codec=H264), other), 0.0)
    assert taken(waiting) == ""


def test_a_robot_that_makes_no_key_frames_is_named():
    waiting = WaitingFrames()
    put(waiting, "FFF", at_s=10.0, step_s=1.0)
    assert waiting.lack(11.9) == ""
    assert "no key frame for 3 s" in waiting.lack(13.0)
    put(waiting, "K", at_s=13.0)
    assert waiting.lack(20.0) == ""


async def test_a_source_is_asked_for_the_shape_that_the_camera_has_now(world, monkeypatch):
    """web_video_server makes the requested size of any shape, also after a camera has got another one."""
    monkeypatch.setattr(shared_sources, "SIZE_KEPT_S", 0.0)
    world.socket.ask("stream_request", width=320, height=240)
    await world.until_open()
    for own, asked in (
        ((640, 480), (320, 240)),
        ((640, 360), (320, 180)),
        ((300, 200), (None, None)),
    ):

        def is_asked(own=own, asked=asked):
            for request, take in tuple(world.open.items()):
                world.now_s += 0.01
                size = own if request.width is None else (request.width, request.height)
                take(CameraFrame(fake_jpeg(1, size=size), world.now_s, world.now_s))
            request = world.receiver._source_switch.source_request
            return world.receiver._own_size == own and (request.width, request.height) == asked

        await eventually(is_asked, lambda: str(list(world.open)))


async def test_a_source_that_makes_no_sizes_shows_the_cameras_own(world):
    """Another source of it is not opened: raw images over rosbridge take a process of their own."""
    world.kind = "rosbridge"
    world.socket.ask("stream_request", width=320, height=240)
    await world.until_open()
    await world.pass_on(fake_jpeg(1))
    assert world.receiver._own_size == (640, 480)
