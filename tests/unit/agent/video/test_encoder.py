"""The encoder's process with PyAV, and what its client says when there is none."""

import base64
import os
import resource
import struct
import sys
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import pytest
from fake_cameras import fake_jpeg
from fake_cloud import eventually
from openssh_server import descendants
from robotether_agent.video import encoder as encoder_module
from robotether_agent.video import encoder_process
from robotether_agent.video.encoder import COMMAND, VideoEncoder
from robotether_agent.video.encoder_messages import EncodeRequest, EncoderError, FrameRefusedError
from robotether_agent.video.encoding import bits_per_s
from robotether_agent.video.image_process import H264Frames
from robotether_common.codecs import H264, VP8
from video_clips import Decoder, clip, jpeg_of, pixels_of, psnr

SIZE = (320, 240)
RATE = bits_per_s(50, SIZE, 15)
NOTHING = EncodeRequest(b"", H264, *SIZE, bits_per_s=RATE, fps=15, allows_hardware=False)


@pytest.fixture
def start(spawn):
    """Starts encoders of a command."""

    async def started(command=COMMAND):
        encoder = VideoEncoder(lambda: None, "/camera", command)
        spawn(encoder.run())
        await eventually(lambda: not encoder.down_reason, lambda: encoder.down_reason, 30)
        return encoder

    return started


@pytest.fixture
def program(tmp_path):
    def command(code):
        lines = (
            "import os, sys, time",
            "os.write(1, bytes(4))",
            "length = int.from_bytes(sys.stdin.buffer.read(4), 'big')",
            code,
        )
        file = tmp_path / "encoder.py"
        file.write_text("\n".join(lines))
        return (sys.executable, str(file))

    return command


@pytest.mark.parametrize(("codec", "worst_allowed"), [(H264, -1.5), (VP8, -3.0)])
async def test_a_stream_decodes_frame_by_frame_and_is_about_as_good_as_jpeg(
    start, codec, worst_allowed
):
    encoder, decoder = await start(), Decoder(codec.name)
    total, jpegs, keys, worst = 0, 0, 0, 99.0
    for number, picture in enumerate(clip(30, step=2)):
        request = replace(NOTHING, jpeg=jpeg_of(picture), codec=codec)
        frame = await encoder.encode(request)
        shown = decoder.decode(frame.data)
        keys += frame.is_key
        if number >= 5:
            as_jpeg = jpeg_of(picture, 50)
            total, jpegs = total + len(frame.data), jpegs + len(as_jpeg)
            worst = min(worst, psnr(picture, shown) - psnr(picture, pixels_of(as_jpeg)))
    assert keys == 1
    assert total < 0.45 * jpegs
    assert worst > worst_allowed
    assert frame.encoder == {"h264": "libx264", "vp8": "libvpx"}[codec.name]
    assert 0 < frame.took_s < 3


async def test_colours_are_those_of_the_camera(start):
    """JPEG has the full range and video the limited one: white stays white, black black, and red red."""
    encoder, decoder = await start(), Decoder()
    for colour in ((255, 255, 255), (0, 0, 0), (200, 30, 30)):
        picture = next(clip(1, step=0)) * 0 + colour
        jpeg = jpeg_of(picture.astype("uint8"))
        shown = decoder.decode((await encoder.encode(replace(NOTHING, jpeg=jpeg))).data)
        assert abs(shown.astype(int) - picture).max() <= 8


async def test_a_frame_has_the_bits_of_its_request_and_another_size_begins_a_stream(start):
    """A step down and back needs no key frame, two steps need one; no frame has more than twice its bits."""
    encoder, decoder = await start(), Decoder()
    jpegs = [jpeg_of(picture) for picture in clip(25, step=9, noise=8)]
    means = []
    for part, size, begins in (
        (1.0, SIZE, True),
        (0.68, SIZE, False),
        (1.0, SIZE, False),
        (0.4, SIZE, True),
        (0.4, (160, 120), True),
    ):
        request = replace(NOTHING, width=size[0], height=size[1], bits_per_s=part * RATE)
        frames = [await encoder.encode(replace(request, jpeg=jpeg)) for jpeg in jpegs]
        assert [frame.is_key for frame in frames] == [begins] + 24 * [False]
        opened = 1.0 if part == 0.68 else part
        assert max(len(frame.data) for frame in frames) < 2.1 * opened * RATE / 15 / 8
        assert {decoder.decode(frame.data).shape[1::-1] for frame in frames} == {size}
        means.append(sum(len(frame.data) for frame in frames[5:]) / 20)
    assert 0.55 < means[1] / means[0] < 0.9
    assert 0.3 < means[3] / means[0] < 0.5


def lying_twice(jpeg):
    """A JPEG with another frame header after its own."""
    header = b"\xff\xc0" + struct.pack("!HBHHB", 17, 8, 60000, 60000, 3)
    components = bytes((1, 0x11, 0, 2, 0x11, 0, 3, 0x11, 0))
    at = jpeg.index(b"\xff\xc4")
    return jpeg[:at] + header + components + jpeg[at:]


@pytest.mark.parametrize(
    ("jpeg", "reason"),
    [
        (b"\xff\xd8 and no more", "cannot be decoded"),
        (fake_jpeg(1), "cannot be decoded"),
        (fake_jpeg(1, size=(60000, 60000)), "cannot be decoded"),
        (lying_twice(jpeg_of(next(clip(1, step=0)))), "cannot be decoded"),
    ],
    ids=["no_header", "no_data", "lying_header", "second_header"],
)
async def test_a_frame_that_cannot_be_decoded_is_refused_and_harms_no_other(start, jpeg, reason):
    encoder, decoder = await start(), Decoder()
    good = [jpeg_of(picture) for picture in clip(3, step=2)]
    decoder.decode((await encoder.encode(replace(NOTHING, jpeg=good[0]))).data)
    with pytest.raises(FrameRefusedError, match=reason):
        await encoder.encode(replace(NOTHING, jpeg=jpeg))
    for each in good[1:]:
        frame = await encoder.encode(replace(NOTHING, jpeg=each))
        assert not frame.is_key
        decoder.decode(frame.data)


async def test_frames_refused_in_a_row_end_the_encoder(start):
    encoder = await start()
    for _ in range(3):
        with pytest.raises(FrameRefusedError):
            await encoder.encode(replace(NOTHING, jpeg=b"\xff\xd8"))
    assert "cannot be decoded" in encoder.down_reason


def of_process(pid, name):
    return Path(f"/proc/{pid}/{name}").read_text().strip()


async def test_the_process_steps_back_behind_the_robots_own(start):
    """Its priority is the least, it is the first that ends for want of memory, and it has a limit."""
    await start()
    (pid,) = descendants(os.getpid())
    assert os.getpriority(os.PRIO_PROCESS, pid) >= 10
    assert of_process(pid, "oom_score_adj") == "1000"
    assert resource.prlimit(pid, resource.RLIMIT_DATA) == (192 * 2**20, 192 * 2**20)


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("time.sleep(60)", "made no frame within 0.5 s"),
        ("os.write(1, b'\\xff' * 8); time.sleep(60)", "makes no sense"),
        ("os.write(1, bytes((0, 0, 0, 1, 9))); time.sleep(60)", "makes no sense"),
    ],
    ids=["hangs", "endless", "garbled"],
)
async def test_a_broken_process_is_an_error_with_its_reason(
    start, program, monkeypatch, code, reason
):
    monkeypatch.setattr(encoder_module, "ANSWER_S", 0.5)
    encoder = await start(program(code))
    with pytest.raises(EncoderError, match=reason):
        await encoder.encode(replace(NOTHING, jpeg=b"x"))
    assert reason.removeprefix("made ") in encoder.down_reason
    with pytest.raises(EncoderError, match=reason):
        await encoder.encode(NOTHING)


def test_hardware_is_tried_once_in_each_size_and_left_after_a_failure(monkeypatch):
    trials, check = [], encoder_process.check_hardware
    nvenc, software = (
        next(kind for kind in encoder_process.ENCODERS if kind.name == name)
        for name in ("h264_nvenc", "libx264")
    )
    answers = replace(software, is_hardware=True)
    monkeypatch.setattr(encoder_process, "ENCODERS", (nvenc, answers, software))
    monkeypatch.setattr(
        encoder_process,
        "check_hardware",
        lambda kind, request: trials.append((kind, request.width)) or check(kind, request),
    )
    transcoder = encoder_process.FrameTranscoder()
    request = replace(NOTHING, jpeg=jpeg_of(next(clip(1, step=0))), allows_hardware=True)
    for width in (320, 160, 320):
        assert transcoder.encode(replace(request, width=width)).is_key
    assert trials == [(kind, width) for width in (320, 160) for kind in (nvenc, answers)]
    with monkeypatch.context() as narrow:
        narrow.setattr(encoder_process, "MAX_DEPENDENT_FRAME_BYTES", 0)
        with pytest.raises(FrameRefusedError, match="made a frame of"):
            transcoder.encode(request)
    assert transcoder.encode(request).is_key
    assert transcoder._encoder.kind is software


@pytest.mark.parametrize(("shift", "chroma"), [(2, True), (0, False)])
def test_hardware_that_makes_another_picture_is_refused(monkeypatch, shift, chroma):
    """FFmpeg's V4L2 encoder does so if the driver pads rows, or has a buffer for each plane."""

    def broken(encoder, frame, request):
        seen = av.VideoFrame(frame.width, frame.height, "yuv420p")
        for number, (plane, to) in enumerate(zip(frame.planes, seen.planes, strict=True)):
            rows = bytes(plane)[: plane.line_size * plane.height]
            moved = b"".join(
                rows[at : at + plane.line_size + shift]
                for at in range(0, len(rows), plane.line_size)
            )
            data = moved[: len(rows)] if chroma or not number else b""
            to.update(data.ljust(to.buffer_size, b"\0"))
        return encode(encoder, seen, request)

    encode = encoder_process.OpenEncoder.encode
    request = replace(NOTHING, width=480)
    [software] = (kind for kind in encoder_process.ENCODERS if kind.name == "libx264")
    encoder_process.check_hardware(software, request)
    monkeypatch.setattr(encoder_process.OpenEncoder, "encode", broken)
    with pytest.raises(FrameRefusedError, match="makes another picture"):
        encoder_process.check_hardware(software, request)


BROKEN_DRIVER = """
import os, signal
from dataclasses import replace
from robotether_agent.video import encoder_process
[software] = [kind for kind in encoder_process.ENCODERS if kind.name == "libx264"]
encoder_process.ENCODERS = (replace(software, is_hardware=True), software)
def check_hardware(*_):
    os.kill(os.getpid(), signal.SIGSEGV)
encoder_process.check_hardware = check_hardware
encoder_process.main()
"""


async def test_a_driver_that_crashes_costs_one_process(start, monkeypatch):
    """The next one encodes in software."""
    monkeypatch.setattr(encoder_module, "PAUSE_S", 0.05)
    encoder = await start((sys.executable, "-c", BROKEN_DRIVER))
    request = replace(NOTHING, jpeg=jpeg_of(next(clip(1, step=0))), allows_hardware=True)
    with pytest.raises(EncoderError, match="SIGSEGV"):
        await encoder.encode(request)
    await eventually(lambda: not encoder.down_reason, lambda: encoder.down_reason, 30)
    assert (await encoder.encode(request)).encoder == "libx264"


def test_h264_without_key_frames_is_decoded_from_a_recovery_point_on():
    """A viewer that comes later gets JPEG of a stream with intra refresh, which has one key frame at its start."""
    encoder = av.CodecContext.create("libx264", "w")
    encoder.width, encoder.height = SIZE
    encoder.pix_fmt, encoder.time_base = "yuv420p", Fraction(1, 30)
    x264 = "intra-refresh=1:repeat-headers=1:annexb=1:keyint=8"
    encoder.options = {"tune": "zerolatency", "x264-params": x264}
    packets = []
    for number in range(30):
        frame = av.VideoFrame(*SIZE, "yuv420p")
        frame.pts = number
        packets += [bytes(packet) for packet in encoder.encode(frame)]
    frames = H264Frames()
    messages = [{"format": "h264", "data": base64.b64encode(data).decode()} for data in packets[3:]]
    assert sum(len(frames.frames_of(message)) for message in messages) > 5
