"""Whether LeRobot's own reader takes what `robotether recording export` writes, and whether each step has its frame.

Exports made-up recordings of two cameras, with losses, delays, frozen video and changes of drivers, as one dataset,
and reads every item by LeRobotDataset, which checks each timestamp to 1e-4 s. Compares it with the truth: each frame
has its number in its pixels. Needs lerobot, which needs 8 GB and other versions than the tests do, so an environment
of its own:

    python3 -m venv /tmp/lerobot && /tmp/lerobot/bin/pip install lerobot==0.4.4 mcap msgspec
    PYTHONPATH=common:server:images/sim_robot:tests/support/fakes /tmp/lerobot/bin/python benchmarks/lerobot_reader.py
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from recorded_drive import RecordedDrive, Row, number_in, pairing_errors
from robotether_server.lerobot.export import ExportOptions, describe_cuts, export

RECORDINGS, FPS = 70, 15


def drive(seed: int) -> RecordedDrive:
    """A recording with some of all that can happen."""
    chance = random.Random(seed)
    change_ms = chance.randint(3000, 5000)
    frozen_ms, idle_ms = chance.randint(1000, 9000), chance.randint(1000, 9000)
    codecs = chance.sample(("jpeg", "h264"), 2)
    return RecordedDrive(
        seed,
        {"/front/image_raw": codecs[0], "/rear/image_raw": codecs[1]},
        seconds=10,
        fps=FPS,
        lost=chance.choice((0, 0.05, 0.2)),
        missed=chance.choice((0, 0.01)),
        refused=chance.choice((0, 0.1)),
        delay_ms=chance.choice((50, 200, 500)),
        drivers=((200, change_ms), (change_ms + 100, 9900)),
        frozen=((frozen_ms, frozen_ms + 1500),),
        idle=((idle_ms, idle_ms + 1300),),
    )


def read(folder: Path, backend: str) -> Iterator[Row]:
    """Read every item of a dataset as a training does."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset: Any = LeRobotDataset("robotether/export", root=folder, video_backend=backend)
    for index in range(len(dataset)):
        item = dataset[index]
        images = [item[key].permute(1, 2, 0).numpy() * 255 for key in dataset.meta.video_keys]
        x, y = item["observation.state"][:2].tolist()
        yield Row(
            int(y),
            tuple(map(number_in, images)),
            tuple(item["observation.seen_age_s"].tolist()),
            x,
            item["action"][0].item(),
        )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=RECORDINGS)
    parser.add_argument("--backend", default="pyav", help="pyav or torchcodec")
    arguments = parser.parse_args()
    drives = [drive(seed) for seed in range(arguments.recordings)]
    with tempfile.TemporaryDirectory() as folder:
        paths = [each.write(Path(folder, f"{each.seed}.mcap")) for each in drives]
        began = time.monotonic()
        report = export(paths, Path(folder, "dataset"), ExportOptions(FPS, (), "Drive."))
        took_s = time.monotonic() - began
        rows = list(read(Path(folder, "dataset"), arguments.backend))
    errors = pairing_errors(drives, rows)
    said = (
        f"{report.episodes} episodes, {report.steps} steps, exported in {took_s:.1f} s",
        f"left out: {describe_cuts(report)}",
        f"{len(rows)} items read with {arguments.backend}, {len(errors)} pairing errors",
        *errors[:10],
    )
    sys.stdout.write("\n".join(said) + "\n")
    return int(bool(errors) or len(rows) != report.steps)


if __name__ == "__main__":
    sys.exit(main())
