"""Writes a LeRobot dataset, version 3: `data` and `meta` as Parquet and JSON, `videos` as MP4.

The layout is that of `lerobot.datasets.lerobot_dataset` 0.4. Each episode has its own file of each camera, which begins
at time 0: timestamps of a long file would be less exact, as the reader has them as float32.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, cast

import av
import numpy as np
import pyarrow as pa
from av.video.frame import VideoFrame
from av.video.stream import VideoStream
from numpy.typing import NDArray
from pyarrow import parquet

from robotether_server.lerobot.pairing import EpisodeStep
from robotether_server.lerobot.statistics import ImageStatistics, describe, sampled_steps

VERSION = "v3.0"
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
# Number of files in a folder, and sizes that only LeRobot's own writer keeps to.
CHUNK_FILES, DATA_FILE_MB, VIDEO_FILE_MB = 1000, 100, 200
STATE, ACTION, AGE = "observation.state", "action", "observation.seen_age_s"
# H.264 that every player reads. Few frames depend on earlier ones, so that a reader can begin anywhere.
VIDEO_CODEC, PIXELS = "libx264", "yuv420p"
VIDEO_OPTIONS = {"crf": "23", "g": "2", "bf": "0"}


@dataclass(frozen=True)
class DatasetLayout:
    """What all episodes have in common. `cameras`: width and height in pixels, by the name in a feature."""

    fps: int
    task: str
    cameras: Mapping[str, tuple[int, int]]
    state_names: Sequence[str]
    action_names: Sequence[str]

    def video_keys(self) -> list[str]:
        """Return the features that are videos, in the order of the cameras."""
        return [f"observation.images.{name}" for name in self.cameras]

    def features(self) -> dict[str, dict[str, Any]]:
        """Return the features as info.json has them."""
        videos = {
            key: self._video(*size)
            for key, size in zip(self.video_keys(), self.cameras.values(), strict=True)
        }
        return {
            **videos,
            STATE: _feature("float32", self.state_names),
            ACTION: _feature("float32", self.action_names),
            AGE: _feature("float32", list(self.cameras)),
            "timestamp": _feature("float32"),
            **{
                name: _feature("int64")
                for name in ("frame_index", "episode_index", "index", "task_index")
            },
        }

    def _video(self, width: int, height: int) -> dict[str, Any]:
        return {
            "dtype": "video",
            "shape": [height, width, 3],
            "names": ["height", "width", "channels"],
            "info": {
                "video.height": height,
                "video.width": width,
                "video.codec": "h264",
                "video.pix_fmt": PIXELS,
                "video.is_depth_map": False,
                "video.fps": self.fps,
                "video.channels": 3,
                "has_audio": False,
            },
        }


def _feature(dtype: str, names: Sequence[str] | None = None) -> dict[str, Any]:
    return {"dtype": dtype, "shape": [len(names) if names else 1], "names": names}


class VideoFile:
    """A video whose frames are 1/fps apart."""

    def __init__(self, path: Path, fps: int, size: tuple[int, int], length: int) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self.statistics = ImageStatistics()
        self._sampled = sampled_steps(length)
        self._left = length
        self._written = 0
        self._container = av.open(str(path), "w", format="mp4")
        stream = self._container.add_stream(VIDEO_CODEC, rate=fps, options=VIDEO_OPTIONS)
        self._stream = cast(VideoStream, stream)
        self._stream.width, self._stream.height = size
        self._stream.pix_fmt = PIXELS
        self._time_base = Fraction(1, fps)
        self._stream.time_base = self._time_base

    def add(self, image: VideoFrame, times: int) -> bool:
        """Write an image for a number of steps; return whether it was the last."""
        width, height = self._stream.width, self._stream.height
        pixels = np.asarray(image.to_ndarray(format="rgb24", width=width, height=height), np.uint8)
        frame = VideoFrame.from_ndarray(pixels, format="rgb24").reformat(format=PIXELS)
        frame.time_base = self._time_base
        for _ in range(times):
            if self._written in self._sampled:
                self.statistics.add(pixels)
            frame.pts = self._written
            self._container.mux(self._stream.encode(frame))
            self._written += 1
        self._left -= times
        if self._left == 0:
            self._container.mux(self._stream.encode(None))
            self.close()
        return self._left == 0

    def close(self) -> None:
        """Close the file."""
        self._container.close()


class DatasetWriter:
    """Writes into an empty folder; without `finish` it is no dataset."""

    def __init__(self, folder: Path, layout: DatasetLayout) -> None:
        self._folder = folder
        self._layout = layout
        # What info.json and stats.json say, and the rows of the episodes' table.
        self._features = layout.features()
        self._episodes: list[dict[str, Any]] = []
        self._columns: list[dict[str, NDArray[Any]]] = []
        self._sizes = dict(zip(layout.video_keys(), layout.cameras.values(), strict=True))
        self._images = {key: ImageStatistics() for key in self._sizes}
        self._open: dict[tuple[int, str], VideoFile] = {}
        path = folder / DATA.format(chunk_index=0, file_index=0)
        path.parent.mkdir(parents=True)
        self._schema = self._data_schema()
        self._data = parquet.ParquetWriter(path, self._schema)

    @property
    def steps(self) -> int:
        """The number of steps of all episodes."""
        return self._episodes[-1]["dataset_to_index"] if self._episodes else 0

    def add_episode(self, steps: Sequence[EpisodeStep]) -> int:
        """Write the steps of an episode, and return its number; `add_image` adds its images."""
        number, first, length = len(self._episodes), self.steps, len(steps)
        columns = self._columns_of(steps, number, first)
        arrays = [
            pa.array(
                list(columns[name]) if columns[name].shape[1] > 1 else columns[name][:, 0], kind
            )
            for name, kind in zip(self._schema.names, self._schema.types, strict=True)
        ]
        self._data.write_table(pa.table(arrays, schema=self._schema))
        self._columns.append(columns)
        row: dict[str, Any] = {
            "episode_index": number,
            "tasks": [self._layout.task],
            "length": length,
            "data/chunk_index": 0,
            "data/file_index": 0,
            "dataset_from_index": first,
            "dataset_to_index": first + length,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        }
        for name, values in columns.items():
            row |= _flat(name, describe(values))
        for key in self._sizes:
            chunk_index, file_index = divmod(number, CHUNK_FILES)
            row |= {
                f"videos/{key}/chunk_index": chunk_index,
                f"videos/{key}/file_index": file_index,
                f"videos/{key}/from_timestamp": 0.0,
                f"videos/{key}/to_timestamp": length / self._layout.fps,
            }
        self._episodes.append(row)
        return number

    def add_image(self, number: int, key: str, image: VideoFrame, times: int) -> None:
        """Add an image to a video of an episode, for a number of steps."""
        video = self._open.get((number, key))
        if video is None:
            video = self._open[number, key] = self._new_video(number, key)
        if video.add(image, times):
            del self._open[number, key]
            self._images[key].add_all(video.statistics)
            self._episodes[number] |= _flat(key, video.statistics.describe())

    def finish(self) -> None:
        """Write what is to be said of all; the folder is a dataset from now on."""
        self._data.close()
        self._write_tasks()
        path = self._folder / EPISODES
        path.parent.mkdir(parents=True)
        parquet.write_table(pa.Table.from_pylist(self._episodes), path)
        every = {
            name: describe(np.concatenate([columns[name] for columns in self._columns]))
            for name in self._schema.names
        }
        images = {key: statistics.describe() for key, statistics in self._images.items()}
        self._write_json("meta/stats.json", images | every)
        self._write_json("meta/info.json", self._info())

    def close(self) -> None:
        """Close what is open, after a failure, too."""
        self._data.close()
        for video in self._open.values():
            video.close()

    def _new_video(self, number: int, key: str) -> VideoFile:
        row = self._episodes[number]
        name = VIDEO.format(
            video_key=key,
            chunk_index=row[f"videos/{key}/chunk_index"],
            file_index=row[f"videos/{key}/file_index"],
        )
        return VideoFile(
            self._folder / name, self._layout.fps, self._sizes[key], length=row["length"]
        )

    def _columns_of(
        self, steps: Sequence[EpisodeStep], number: int, first: int
    ) -> dict[str, NDArray[Any]]:
        """Return the values (steps, numbers of a step) of each feature."""
        count = np.arange(len(steps), dtype=np.int64)
        columns: dict[str, NDArray[Any]] = {
            STATE: np.array([step.state for step in steps], np.float32),
            ACTION: np.array([step.action for step in steps], np.float32),
            AGE: np.array([step.ages_s for step in steps], np.float32),
            "timestamp": (count / self._layout.fps).astype(np.float32),
            "frame_index": count,
            "episode_index": np.full_like(count, number),
            "index": count + first,
            "task_index": np.zeros_like(count),
        }
        return {name: values.reshape(len(steps), -1) for name, values in columns.items()}

    def _data_schema(self) -> pa.Schema:
        fields = []
        for name, feature in self._features.items():
            if feature["dtype"] == "video":
                continue
            kind, (length,) = pa.type_for_alias(feature["dtype"]), feature["shape"]
            fields.append((name, kind if length == 1 else pa.list_(kind, length)))
        return pa.schema(fields)

    def _write_tasks(self) -> None:
        """Write the one task as pandas writes a table whose index is the text."""
        index = "__index_level_0__"
        about = {
            "index_columns": [index],
            "column_indexes": [],
            "columns": [
                _pandas_column("task_index", "task_index", "int64", "int64"),
                _pandas_column(None, index, "unicode", "object"),
            ],
            "pandas_version": "2.0.0",
        }
        columns = {"task_index": pa.array([0], pa.int64()), index: [self._layout.task]}
        table = pa.table(columns).replace_schema_metadata({"pandas": json.dumps(about)})
        path = self._folder / "meta/tasks.parquet"
        path.parent.mkdir(exist_ok=True)
        parquet.write_table(table, path)

    def _info(self) -> dict[str, Any]:
        return {
            "codebase_version": VERSION,
            # Nobody knows it: a recording does not say.
            "robot_type": None,
            "total_episodes": len(self._episodes),
            "total_frames": self.steps,
            "total_tasks": 1,
            "chunks_size": CHUNK_FILES,
            "data_files_size_in_mb": DATA_FILE_MB,
            "video_files_size_in_mb": VIDEO_FILE_MB,
            "fps": self._layout.fps,
            "splits": {"train": f"0:{len(self._episodes)}"},
            "data_path": DATA,
            "video_path": VIDEO,
            "features": self._features,
        }

    def _write_json(self, name: str, value: object) -> None:
        text = json.dumps(value, indent=4, ensure_ascii=False, allow_nan=False)
        (self._folder / name).write_text(text, encoding="utf-8")


def _flat(name: str, statistics: Mapping[str, Any]) -> dict[str, Any]:
    return {f"stats/{name}/{figure}": value for figure, value in statistics.items()}


def _pandas_column(
    name: str | None, field_name: str, pandas_type: str, numpy_type: str
) -> dict[str, Any]:
    return {
        "name": name,
        "field_name": field_name,
        "pandas_type": pandas_type,
        "numpy_type": numpy_type,
        "metadata": None,
    }
