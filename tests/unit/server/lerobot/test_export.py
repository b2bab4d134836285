"""The export of recordings as a LeRobot dataset: what is paired with what, and what a hostile file can do."""

import json
import os
import struct
from dataclasses import replace
from operator import attrgetter

import av
import numpy as np
import pytest
from click.testing import CliRunner
from mcap.writer import CompressionType, Writer
from pyarrow import parquet
from recorded_drive import (
    BASE_NS,
    HEIGHT,
    ODOMETRY,
    WIDTH,
    RecordedDrive,
    Row,
    number_in,
    odometry,
    own_message,
    pairing_errors,
    picture,
    write_all,
)
from robotether_server.cli.main import cli
from robotether_server.lerobot.export import ExportOptions, export
from robotether_server.lerobot.recording import NotExportedError
from robotether_server.recorder.channels import CameraWriter, channel_of
from robotether_server.recorder.mcap_file import RecordedMessage
from video_clips import jpeg_of

FRONT, REAR = "/front/image_raw", "/rear/image_raw"
OPTIONS = ExportOptions(None, (), "DriveData.")
# Median difference of pixels from what the camera saw, of 255.
MAX_CODING_ERROR = 7
LATE = {"lost": 0.1, "delay_ms": 400, "refused": 0.1}


def rows_of(folder):
    """What is in a dataset, by its Parquet files and videos alone."""
    info = json.loads((folder / "meta/info.json").read_text())
    keys = [key for key, feature in info["features"].items() if feature["dtype"] == "video"]
    episodes = parquet.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    steps = parquet.read_table(folder / "data/chunk-000/file-000.parquet").to_pylist()
    rows = []
    for episode in episodes:
        videos = [numbers_of(folder / path_of(info, episode, key), info["fps"]) for key in keys]
        of_episode = steps[episode["dataset_from_index"] : episode["dataset_to_index"]]
        assert [len(video) for video in videos] == [len(of_episode)] * len(keys)
        for step, *numbers in zip(of_episode, *videos, strict=True):
            assert step["timestamp"] == pytest.approx(step["frame_index"] / info["fps"], abs=1e-4)
            ages_s, state = step["observation.seen_age_s"], step["observation.state"]
            rows.append(
                Row(
                    int(state[1]),
                    tuple(numbers),
                    tuple(ages_s) if isinstance(ages_s, list) else (ages_s,),
                    state[0],
                    step["action"][0],
                )
            )
    return rows


def path_of(info, episode, key):
    return info["video_path"].format(
        video_key=key,
        chunk_index=episode[f"videos/{key}/chunk_index"],
        file_index=episode[f"videos/{key}/file_index"],
    )


def numbers_of(path, fps):
    """The numbers in the frames of a video, which are 1/fps apart."""
    numbers = []
    with av.open(str(path)) as video:
        for frame in video.decode(video=0):
            assert frame.time == pytest.approx(len(numbers) / fps, abs=1e-6)
            pixels = frame.to_ndarray(format="rgb24")
            numbers.append(number_in(pixels))
            small = pixels[:: len(pixels) // HEIGHT, :: len(pixels[0]) // WIDTH]
            error = np.median(np.abs(small - picture(numbers[-1]).astype(float)))
            assert error < MAX_CODING_ERROR
    return numbers


@pytest.mark.parametrize(
    "drive",
    [
        RecordedDrive(1, other_from=60),
        RecordedDrive(2, {FRONT: "h264"}, missed=0.02, **LATE),
        RecordedDrive(
            3,
            {FRONT: "jpeg", REAR: "h264"},
            drivers=((300, 3500), (3600, 7800)),
            frozen=((1500, 3000),),
            idle=((5000, 6600),),
            stopped=((7000, 7300),),
            **LATE,
        ),
    ],
    ids=["JPEG of two sizes", "H.264 with losses", "two cameras and all else"],
)
def test_a_dataset_has_what_the_driver_had_seen(tmp_path, drive):
    report = export([drive.write(tmp_path / "1.mcap")], tmp_path / "dataset", OPTIONS)
    rows = rows_of(tmp_path / "dataset")
    assert pairing_errors([drive], rows) == []
    assert len(rows) == report.steps >= 60
    json.loads((tmp_path / "dataset/meta/stats.json").read_text())


def write_compressed(path):
    writer = Writer(str(path), compression=CompressionType.LZ4)
    writer.start()
    schema = writer.register_schema("a", "ros2msg", b"")
    channel = writer.register_channel("/a", "cdr", schema)
    writer.add_message(channel, 0, bytes(1000), 0)
    writer.finish()


def write_long(path):
    path.write_bytes(b"\x89MCAP0\r\n" + struct.pack("<BQ", 6, 2**26))
    os.truncate(path, 2**27)


def write_with_clock_set_back(path):
    """Write two drives of the same times, one after the other."""
    drives = [RecordedDrive(seed, seconds=4).messages() for seed in (1, 2)]
    write_all(path, (each for drive in drives for each in sorted(drive, key=attrgetter("log_ns"))))


def write_with_clock_ahead(path):
    drive = RecordedDrive(1, seconds=4)
    members = drive.command_members(drive.commands[0])
    drive.write(path, extra=[own_message("commands", members, 3 * 86_400_000)])


def damaged(change):
    """A recording of which something was changed."""

    def write(path):
        path.write_bytes(change(RecordedDrive(1, seconds=2).write(path).read_bytes()))

    return write


@pytest.mark.parametrize(
    ("write", "why"),
    [
        (lambda path: path.write_bytes(b"no recording"), "not a recording"),
        (damaged(lambda data: data[:-20_000]), "has no end"),
        (damaged(lambda data: data[:9] + b"\xff" * 8 + data[17:]), "has no end"),
        (damaged(lambda data: data[:50_000] + b"?" + data[50_001:]), "damaged"),
        (write_compressed, "compressed"),
        (write_long, "larger than"),
        (RecordedDrive(1, seconds=3, other_from=20, other_size=(96, 96)).write, "96x64"),
        (RecordedDrive(1, seconds=2, drivers=()).write, "no recorded camera"),
        (RecordedDrive(1, seconds=2, frozen=((0, 2000),)).write, "no episode"),
        (RecordedDrive(1, {"/a/b": "jpeg", "/a_b": "jpeg"}).write, "same name"),
        (write_with_clock_set_back, "no episode.*set back"),
        (write_with_clock_ahead, "jumped by 3 days"),
    ],
    ids=[
        "another",
        "cut",
        "length",
        "checksum",
        "compressed",
        "long",
        "shapes",
        "undriven",
        "frozen",
        "names",
        "clock set back",
        "clock ahead",
    ],
)
def test_what_cannot_be_exported_leaves_nothing(tmp_path, write, why):
    write(tmp_path / "1.mcap")
    with pytest.raises(NotExportedError, match=why):
        export([tmp_path / "1.mcap"], tmp_path / "dataset", OPTIONS)
    assert not (tmp_path / "dataset").exists()


def test_of_several_odometries_one_is_no_guess(tmp_path):
    """The robot's namespace decides, else the person."""
    drive = RecordedDrive(1)

    def others(*topics):
        return [
            odometry(at_ms, 0.0, 90.0 + number, topic)
            for number, topic in enumerate(topics)
            for at_ms in range(0, 8000, 40)
        ]

    own = drive.write(tmp_path / "1.mcap", extra=others("/a/odom"))
    export([own], tmp_path / "own", OPTIONS)
    assert {row.seed for row in rows_of(tmp_path / "own")} == {1}
    drive.states_ms = ()
    doubtful = drive.write(tmp_path / "2.mcap", extra=others("/a/odom", "/b/odom"))
    with pytest.raises(NotExportedError, match="/a/odom, /b/odom; choose one with --odometry"):
        export([doubtful], tmp_path / "doubtful", OPTIONS)
    export([doubtful], tmp_path / "named", replace(OPTIONS, odometry="/b/odom"))
    assert {row.seed for row in rows_of(tmp_path / "named")} == {91}


def test_what_a_robot_names_and_says_stays_data(tmp_path):
    """A path as a camera's name, a frame of 10 megapixels, texts and numbers that are none."""
    camera = "/../../\x1b[2J/x"
    drive = RecordedDrive(1, {camera: "jpeg"})
    frames = drive.frames[camera]
    hostile = [
        *(odometry(at_ms, float("nan")) for at_ms in range(2001, 2100, 10)),
        *(odometry(at_ms, 1e300) for at_ms in range(2101, 2200, 10)),
        *(
            RecordedMessage(channel_of("/odom", ODOMETRY), BASE_NS, BASE_NS, 0, data)
            for data in (b"", b"\0\1\0\0", b"\0\1\0\0" + b"\xff" * 800)
        ),
        CameraWriter(camera, "gif").message(b"GIF", log_ns=BASE_NS, taken_ns=BASE_NS, sequence=3),
        CameraWriter(camera, "h264").message(
            b"\0\0\1\x67\xff", log_ns=BASE_NS, taken_ns=BASE_NS, sequence=3
        ),
    ]
    bomb = frames[50]
    path = drive.write(
        tmp_path / "1.mcap",
        extra=hostile,
        images={bomb.number: jpeg_of(np.zeros((3200, 3200, 3), np.uint8))},
    )
    export([path], tmp_path / "dataset", OPTIONS)
    rows = rows_of(tmp_path / "dataset")
    assert pairing_errors([drive], rows) == []
    numbers = [row.numbers[0] for row in rows]
    assert bomb.number - 1 in numbers
    assert bomb.number not in numbers
    assert [path.name for path in (tmp_path / "dataset/videos").iterdir()] == [
        "observation.images._2J_x"
    ]


def test_the_command_says_what_became_of_a_recording(tmp_path):
    path, folder = RecordedDrive(1, seconds=4).write(tmp_path / "1.mcap"), tmp_path / "dataset"
    arguments = ["recording", "export", str(path), "--lerobot", str(folder)]
    done = CliRunner().invoke(cli, arguments)
    assert done.output.splitlines() == [
        "episodes  1",
        "steps     69, 15 a second (the median of the quickest camera)",
        "cameras   /front/image_raw",
        "left out  2.9 s: what the driver had seen was older than 1 s",
    ]
    again = CliRunner().invoke(cli, arguments)
    assert str(again.exception) == f"cannot export to {folder}: it exists; name a new folder"
