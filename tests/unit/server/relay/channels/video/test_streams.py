"""Multipart streams out of a feed, as <img> and programs read them."""

import asyncio
import io
import time

import aiohttp
import av
import pytest
from fake_robot import JPEG, WAIT_S
from h264_frames import encoded_frames
from relay_server import ANN, BOB, until
from robotether_common.frames import ENCODER_STARTS, QOS


async def head_and_frame(answer):
    async with asyncio.timeout(5):
        lines = (await answer.content.readuntil(b"\r\n\r\n")).decode().split("\r\n")
        headers = dict(line.split(": ") for line in lines if ": " in line)
        assert int(headers["Content-Length"]) == len(JPEG)
        frame = await answer.content.readexactly(len(JPEG))
        boundary = answer.headers["Content-Type"].partition("boundary=")[2]
        assert await answer.content.readuntil(b"\n") == b"\r\n"
        assert await answer.content.readuntil(b"\n") == f"--{boundary}\r\n".encode()
    return headers, frame


async def showing(camera):
    while True:
        await camera.show(JPEG)
        await asyncio.sleep(0.01)


@pytest.fixture
async def on_air(camera):
    task = asyncio.create_task(showing(camera))
    yield camera
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


async def test_a_stream_comes_out_of_the_feed(relay, on_air, robot, video):
    async with video("stream?topic=/a") as answer:
        assert answer.status == 200
        assert answer.content_type == "multipart/x-mixed-replace"
        assert answer.headers["Cache-Control"] == "no-store"
        assert answer.headers["Content-Security-Policy"] == "sandbox"
        assert answer.headers["Cross-Origin-Resource-Policy"] == "same-origin"
        await answer.content.readuntil(b"\r\n")
        sequences = []
        for _ in range(3):
            headers, frame = await head_and_frame(answer)
            assert frame == JPEG
            # The robot's clock is further from this one.
            assert 0 <= time.time() - float(headers["X-Timestamp"]) < WAIT_S
            sequences.append(int(headers["X-Sequence"]))
        assert sorted(set(sequences)) == sequences
    assert on_air.topics == ["/a"]
    assert robot.video_requests == []
    await until(lambda: not on_air.connections, "the feed is closed")
    viewer_counts = relay.relay.registry.robot(7).viewer_stats.of(ANN.id)
    assert viewer_counts.frames >= 3
    assert viewer_counts.bytes == viewer_counts.frames * len(JPEG)


async def test_a_quality_is_the_best_that_is_wanted(on_air, video):
    async with video("stream?topic=/a&quality=15&width=320&height=240") as answer:
        assert answer.status == 200
    await on_air.wait_for("stream_request", quality_min=15, quality_max=15, width=320, height=240)


async def test_what_no_feed_can_is_passed_through_and_an_invalid_request_is_refused(
    on_air, robot, video
):
    passed = ("type=vp8", "invert=1", "default_transport=theora")
    for more in passed:
        async with video(f"stream?topic=/a&{more}") as answer:
            await asyncio.wait_for(answer.content.readuntil(JPEG), 5)
    for query in ("quality=0", "quality=high", "width=320", "width=5000&height=1", "quality=1e2",
                  "codec=vp9", "codec=h264&invert=1", "codec=h264&type=mjpeg"):  # fmt: skip
        async with video(f"stream?topic=/a&{query}") as answer:
            assert (answer.status, (await answer.json())["code"]) == (422, "field_invalid")
    asked = [f"/stream?topic=/a&{more}&{QOS}" for more in passed]
    assert [request["path"] for request in robot.video_requests] == asked
    assert on_air.topics == []


async def test_a_ticket_lets_pages_of_others_show_it_and_allowed_ones_read_it(
    relay, sim1, on_air, video
):
    ticket = relay.ticket(sim1)
    for path in (f"stream?topic=/a&ticket={ticket}", f"snapshot?topic=/a&ticket={ticket}"):
        async with video(path, {}) as answer:
            assert answer.headers["Cross-Origin-Resource-Policy"] == "cross-origin"
        async with video(path, {"Origin": "https://lab.example"}) as answer:
            assert answer.headers["Access-Control-Allow-Origin"] == "https://lab.example"
            assert "Access-Control-Allow-Credentials" not in answer.headers
        async with video(path, {"Origin": "https://evil.example"}) as answer:
            assert answer.status == 403
            assert "Access-Control-Allow-Origin" not in answer.headers


async def show_each(camera, frames, codec):
    for frame, is_key in frames:
        await until(lambda: all(camera.credits.values()), "the robot has credit")
        await camera.show(frame, codec=codec, is_key=is_key)


async def test_a_player_gets_h264(*, relay, sim1, camera, video, monkeypatch):
    """A ticket opens it; it begins with a key frame and ends when the robot sends JPEG.

    It gets another one soon: `ffmpeg -fflags nobuffer` drops those with which it learns what the stream is.
    """
    monkeypatch.setattr("robotether_server.relay.channels.video.streams.KEY_FRAME_S", 0.01)
    path = f"stream?topic=/a&codec=h264&ticket={relay.ticket(sim1)}"
    asking = asyncio.create_task(video(path, {}))
    await camera.wait_for("stream_request", codecs=["h264", "jpeg"])
    await camera.wait_for("credit")
    # An encoder takes some time to begin.
    await camera.send_status(state="live", no_encoder=ENCODER_STARTS)
    await show_each(camera, [(JPEG, False)] * 3, 1)
    frames, stream = encoded_frames(9), b""
    await show_each(camera, frames, 2)
    async with await asking as answer, asyncio.timeout(10):
        assert (answer.status, answer.content_type) == (200, "video/mp2t")
        assert answer.headers["Content-Security-Policy"] == "sandbox"
        assert answer.headers["Cross-Origin-Resource-Policy"] == "cross-origin"
        # The last one has begun.
        while stream.count(b"\0\0\1\xe0") < len(frames):
            stream += await answer.content.readany()
        await camera.wait_for("key_frame")
        await camera.show(JPEG)
        with pytest.raises(aiohttp.ClientError):
            await answer.read()
    with av.open(io.BytesIO(stream), format="mpegts") as player:
        assert len(list(player.decode(video=0))) >= len(frames) - 1
    assert relay.relay.registry.robot(7).viewer_stats.of(ANN.id).frames == len(frames)


async def ask_in_vain(video):
    async with video("stream?topic=/a&codec=h264") as answer:
        problem = await answer.json()
    return answer.status, problem["code"], problem["detail"].partition(": ")[2]


@pytest.mark.parametrize(
    ("no_encoder", "why"),
    [("PyAV is missing", "PyAV is missing"), ("", "its agent sends jpeg")],
    ids=["says why", "is older"],
)
async def test_a_robot_that_sends_jpeg_has_no_h264(
    *, relay, on_air, monkeypatch, no_encoder, why, video
):
    monkeypatch.setattr("robotether_server.relay.channels.video.streams.FIRST_FRAME_WITHIN_S", 1.0)
    asking = asyncio.create_task(ask_in_vain(video))
    await on_air.wait_for("credit")
    await on_air.send_status(state="live", no_encoder=no_encoder)
    assert await asking == (409, "no_encoder", why)


async def test_a_camera_without_a_frame_is_no_frames(relay, camera, monkeypatch, video):
    monkeypatch.setattr("robotether_server.relay.channels.video.streams.FIRST_FRAME_WITHIN_S", 0.5)
    asking = asyncio.create_task(video("stream?topic=/a"))
    await camera.wait_for("stream_request")
    await camera.send_status(state="down", detail="nobody publishes /a")
    async with await asking as answer:
        problem = await answer.json()
    assert (answer.status, problem["code"]) == (502, "no_frames")
    assert "nobody publishes /a" in problem["detail"]


async def test_who_takes_nothing_skips_and_is_cut(relay, camera, watch, monkeypatch, video):
    monkeypatch.setattr("robotether_server.relay.channels.video.streams.VIEWER_SLOW_AFTER_S", 0.5)
    # Under what aiohttp waits for by itself.
    viewer, large = await watch(BOB), b"x" * 60_000
    await camera.wait_for("credit")
    await camera.show(large)
    await viewer.credit()
    await viewer.frame()
    async with video("stream?topic=/a") as answer:
        answer.connection.transport.pause_reading()
        for _ in range(100):
            await viewer.credit()
            sequence = await camera.show(large)
            assert (await viewer.frame()).sequence == sequence
        assert relay.relay.registry.robot(7).viewer_stats.of(ANN.id).frames <= 50
        await until(lambda: relay.relay.connections.count("video") == 1, "it is cut")
        answer.close()
