"""RTSP cameras and devices of the settings, by a process with PyAV."""

import asyncio
import base64
import io
import struct
from contextlib import nullcontext, suppress

import av
import pytest
from fake_cloud import eventually
from local_network import free_port
from robotether_agent.clock import robot_time
from robotether_agent.video import camera_process
from robotether_agent.video import sources as sources_module
from robotether_agent.video.camera_process import Lag
from robotether_agent.video.encoder_messages import EncodeRequest
from robotether_agent.video.encoder_process import FrameTranscoder
from robotether_agent.video.jpeg import jpeg_size
from robotether_agent.video.newest_jpegs import CameraFailedError
from robotether_agent.video.sources import SourceDownError, run_camera
from robotether_common.codecs import H264
from video_clips import clip, jpeg_of, pixels_of, psnr

FPS = 15
RTP = struct.Struct("!BBHII")
CLOCK = 90_000
SPS, PPS = 7, 8


def units_of(data):
    """Return the NAL units of an access unit in Annex B."""
    return [unit.rstrip(b"\0") for unit in data.split(b"\0\0\1")[1:]]


class FakeRtspCamera:
    """A double of an RTSP camera, over TCP alone.

    Modes: `streams` H.264; `refuses` wants a login;
    `redirects` leads to `location`; `describes` has a description that leads there; `audio` has a microphone alone.
    """

    def __init__(self, jpegs, mode="streams", location=""):
        transcoder = FrameTranscoder()
        self.units = [
            units_of(transcoder.encode(EncodeRequest(jpeg, H264, 320, 240, 800_000, FPS)).data)
            for jpeg in jpegs
        ]
        self.mode = mode
        self.location = location
        self.requests = []

    async def __aenter__(self):
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.url = f"rtsp://me:secret@127.0.0.1:{self._server.sockets[0].getsockname()[1]}/video"
        return self

    async def __aexit__(self, *_):
        self._server.close()
        await self._server.wait_closed()

    async def _serve(self, reader, writer):
        playing = None
        with suppress(ConnectionError, asyncio.IncompleteReadError):
            while True:
                request = (await reader.readuntil(b"\r\n\r\n")).decode()
                method = request.split(" ")[0]
                self.requests.append(method)
                writer.write(self._answer(method, request))
                if method == "PLAY" and self.mode == "streams":
                    playing = asyncio.ensure_future(self._play(writer))
        if playing is not None:
            playing.cancel()
            await asyncio.gather(playing, return_exceptions=True)
        writer.close()

    def _answer(self, method, request):
        number = request.lower().split("cseq: ")[1].split("\r\n")[0]
        status, head, body = "200 OK", "", ""
        if self.mode == "refuses" and method != "OPTIONS":
            status, head = "401 Unauthorized", 'WWW-Authenticate: Basic realm="x"\r\n'
        elif method == "OPTIONS":
            head = "Public: DESCRIBE, SETUP, PLAY, TEARDOWN\r\n"
        elif method == "DESCRIBE" and self.mode == "redirects":
            status, head = "302 Found", f"Location: {self.location}\r\n"
        elif method == "DESCRIBE":
            body = self._description()
            head = f"Content-Type: application/sdp\r\nContent-Length: {len(body)}\r\n"
        elif method == "SETUP":
            head = "Transport: RTP/AVP/TCP;unicast;interleaved=0-1\r\n"
        return f"RTSP/1.0 {status}\r\nCSeq: {number}\r\nSession: 1\r\n{head}\r\n{body}".encode()

    def _description(self):
        if self.mode == "audio":
            return "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=x\r\nt=0 0\r\nm=audio 0 RTP/AVP 0\r\na=control:track1\r\n"
        sets = [unit for unit in self.units[0] if unit[0] & 31 in (SPS, PPS)]
        sprop = ",".join(base64.b64encode(unit).decode() for unit in sets)
        control = self.location if self.mode == "describes" else "track1"
        return (
            "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=x\r\nt=0 0\r\nm=video 0 RTP/AVP 96\r\n"
            f"a=rtpmap:96 H264/{CLOCK}\r\n"
            f"a=fmtp:96 packetization-mode=1;sprop-parameter-sets={sprop}\r\na=control:{control}\r\n"
        )

    async def _play(self, writer):
        sequence = number = 0
        while True:
            units = self.units[number % len(self.units)]
            for unit in units:
                marker = 0x80 if unit is units[-1] else 0
                packet = RTP.pack(
                    0x80, 96 | marker, sequence % 65536, number * CLOCK // FPS % 2**32, 1
                )
                writer.write(b"$\0" + struct.pack("!H", len(packet) + len(unit)) + packet + unit)
                sequence += 1
            number += 1
            await asyncio.sleep(1 / FPS)


PICTURES = list(clip(20, step=2))
JPEGS = [jpeg_of(picture) for picture in PICTURES]


async def down_reason(url):
    frames = []
    with pytest.raises(SourceDownError) as down:
        await run_camera(url, frames.append, what="camera rear")
    assert frames == []
    return str(down.value)


async def test_an_rtsp_camera_gives_its_newest_frames_as_jpegs():
    frames = []
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

    async def visited(_, writer):
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


async def test_a_broken_frame_of_a_camera_costs_no_other():
    frames = []
    async with FakeRtspCamera(JPEGS) as camera:
        camera.units[10] = [b"\x41" + b"\xff" * 40]
        reading = asyncio.ensure_future(run_camera(camera.url, frames.append, what="camera rear"))
        await eventually(lambda: len(frames) >= 20 or reading.done(), lambda: str(len(frames)), 30)
        reading.cancel()
        await asyncio.gather(reading, return_exceptions=True)
    assert len(frames) >= 20


@pytest.mark.parametrize(
    ("seconds", "late", "keeps_up", "is_over"),
    [
        # A camera's clock that differs, for two hours; a robot that is too slow, and a line.
        (7200, 0.001, True, False),
        (7200, 0.001, False, True),
        (120, 0.02, True, True),
    ],
)
def test_frames_that_queue_are_told_from_a_clock_that_drifts(seconds, late, keeps_up, is_over):
    lag = Lag()
    with pytest.raises(CameraFailedError) if is_over else nullcontext():
        for number in range(seconds * FPS):
            timestamp_s = number / FPS
            lag.check(1000 + (1 + late) * timestamp_s, timestamp_s, keeps_up=keeps_up)


def test_a_frame_looks_no_newer_for_the_time_in_the_decoder(monkeypatch):
    """With B frames it waits there for a frame that is shown later."""
    file = io.BytesIO()
    with av.open(file, "w", format="matroska") as output:
        stream = output.add_stream("libx264", FPS, {"bf": "2", "x264-params": "b-adapt=0"})
        stream.width, stream.height = 320, 240
        for picture in PICTURES:
            output.mux(stream.encode(av.VideoFrame.from_ndarray(picture, "rgb24")))
        output.mux(stream.encode(None))
    numbers = iter(range(100))
    monkeypatch.setattr(camera_process, "robot_time", lambda: next(numbers))
    with av.open(io.BytesIO(file.getvalue())) as container:
        frames = list(camera_process.frames_of(container))
    assert [frame.timestamp_s for frame in frames[:8]] == [0, 1, 1, 1, 4, 4, 4, 7]


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
