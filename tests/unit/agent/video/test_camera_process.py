"""RTSP cameras and devices of the settings, by a process with PyAV."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

import pytest
from fake_cloud import eventually
from fake_rtsp import FakeRtspCamera
from local_network import free_port
from robotether_agent.clock import robot_time
from robotether_agent.video import sources as sources_module
from robotether_agent.video.jpeg import jpeg_size
from robotether_agent.video.sources import (
    CAMERA_COMMAND,
    CameraFrame,
    SourceDownError,
    run_camera,
)
from video_clips import clip, jpeg_of, pixels_of, psnr

PICTURES = list(clip(20, step=2))
JPEGS = [jpeg_of(picture) for picture in PICTURES]


async def down_reason(url: str, command: Sequence[str] = CAMERA_COMMAND) -> str:
    frames: list[CameraFrame] = []
    with pytest.raises(SourceDownError) as down:
        await run_camera(url, frames.append, what="camera rear", command=command)
    assert frames == []
    return str(down.value)


async def test_an_rtsp_camera_gives_its_newest_frames_as_jpegs():
    frames: list[CameraFrame] = []
    async with FakeRtspCamera(JPEGS) as camera:
        reading = asyncio.ensure_future(run_camera(camera.url, frames.append, what="camera rear"))
        await eventually(lambda: len(frames) >= 30 or reading.done(), lambda: str(len(frames)), 30)
        ages_s = [robot_time() - frames[-1].arrived_s]
        reading.cancel()
        await asyncio.gather(reading, return_exceptions=True)
    assert len(frames) >= 30
    assert {jpeg_size(frame.data) for frame in frames} == {(320, 240)}
    best = max(psnr(pixels_of(frames[-1].data), picture) for picture in PICTURES)
    assert best > 28
    assert [frame.timestamp_s for frame in frames] == sorted(frame.timestamp_s for frame in frames)
    assert 0 <= ages_s[0] < 2


@pytest.mark.parametrize(
    ("mode", "location"),
    [
        ("refuses", ""),
        ("redirects", "file:///etc/passwd"),
        ("redirects", "http://127.0.0.1:{port}/"),
        ("redirects", "rtsp://localhost:{port}/"),
        ("redirects", "rtsp://127.0.0.1@localhost:{port}/"),
        # Longer than a line of FFmpeg's log.
        ("redirects", f"rtsp://127.0.0.1:{'0' * 1100}@localhost:{{port}}/"),
        ("describes", "http://127.0.0.1:{port}/"),
        ("describes", "rtsp://localhost:{port}/"),
    ],
)
async def test_an_answer_that_is_no_camera_is_a_reason_without_the_url(monkeypatch, mode, location):
    """A redirect or description leads neither to a file, nor to another host, nor to an HTTP service of the robot."""
    if mode == "describes":
        # Which only shows as silence.
        monkeypatch.setattr(sources_module, "PROCESS_START_S", 6.0)
    visits = []

    async def visited(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        visits.append(1)
        writer.close()

    async with await asyncio.start_server(visited, "127.0.0.1", 0) as service:
        port = service.sockets[0].getsockname()[1]
        async with FakeRtspCamera(JPEGS[:1], mode, location.format(port=port)) as camera:
            reason = await down_reason(camera.url)
    assert reason.startswith(("camera rear cannot be read: ", "camera rear sent no frame"))
    assert "secret" not in reason
    assert "DESCRIBE" in camera.requests
    assert not visits


async def test_a_camera_without_video_says_so():
    async with FakeRtspCamera(JPEGS[:1], "audio") as camera:
        assert await down_reason(camera.url) == "camera rear cannot be read: it has no video"


async def test_a_redirect_to_the_same_host_is_followed():
    async with FakeRtspCamera(JPEGS[:1], "refuses") as other:
        async with FakeRtspCamera(JPEGS[:1], "redirects", other.url) as camera:
            await down_reason(camera.url)
        assert "DESCRIBE" in other.requests


@pytest.mark.parametrize("url", ["rtsp://me:secret@127.0.0.1:{port}/", "/dev/video999"])
async def test_a_camera_that_is_not_there_is_a_reason(url):
    reason = await down_reason(url.format(port=free_port()))
    assert reason.startswith("camera rear cannot be read: ")
    assert "secret" not in reason


async def test_a_silent_camera_is_given_up(monkeypatch):
    monkeypatch.setattr(sources_module, "PROCESS_START_S", 2.0)
    async with FakeRtspCamera(JPEGS[:1], "silent") as camera:
        assert await down_reason(camera.url) == "camera rear sent no frame for 2 s"


async def test_without_pyav_the_reason_says_what_to_install(monkeypatch):
    monkeypatch.setattr(sources_module, "has_pyav", lambda: False)
    assert "robotether-agent install-video" in await down_reason("rtsp://127.0.0.1/")
