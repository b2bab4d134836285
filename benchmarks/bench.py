"""`make bench`: runs the experiments one after the other and writes docs/measurements.md.

Needs `make demo`, and root for the networks that some experiments create. `--only NAME,...` runs these alone and
replaces their parts of the page. `--quick` repeats less, to check that all of them work, and writes nothing.
"""

from __future__ import annotations

import argparse
import os
import platform
import re
import sys
from collections.abc import Callable, Mapping
from datetime import UTC, datetime

import agent_memory
import audit_verify
import behind_video
import codec_bits
import drive_page
import fan_out
import operations_rate
import recording
import recovery
import round_trip
import seen_age
import stopping
import video
from demo import ROOT, Demo
from report import Section, commit, machine, wrapped

PAGE = ROOT / "docs" / "measurements.md"
HEAD = """# Measurements

`make bench` writes this page. It may measure only some parts again, so each says when and where it
was measured. Compare numbers within a table, not between tables.
"""
# Before each part.
_MARK = re.compile(r"^<!-- experiment: (\w+) -->\n", re.MULTILINE)


# What is measured with the demo, and less of it when it has to be quick.
EXPERIMENTS: Mapping[str, Callable[[Demo, bool], Section]] = {
    "round_trip": lambda demo, quick: round_trip.measure(demo, 200 if quick else 3000),
    "behind_video": lambda _, quick: behind_video.measure(5 if quick else behind_video.SECONDS),
    "bulk_topics": lambda _, quick: behind_video.measure_bulk(5 if quick else behind_video.BULK_SECONDS),
    "mixed_topics": lambda _, quick: behind_video.measure_mixed(5 if quick else behind_video.SECONDS),
    "codecs": lambda _, quick: codec_bits.measure(*((2, codec_bits.SIZES[:1]) if quick else ())),
    "picture_age": lambda demo, quick: video.measure_age(demo, 3 if quick else video.SECONDS),
    "networks": lambda _, quick: video.measure_networks(3 if quick else video.SECONDS),
    "seen_age": lambda demo, quick: seen_age.measure(demo, 5 if quick else seen_age.SECONDS),
    "closed_loop": lambda _, quick: seen_age.measure_loop(5 if quick else seen_age.SECONDS),
    "operators": lambda _, quick: seen_age.measure_operators(*((3, seen_age.PAPERS_NETWORKS[2:3]) if quick else ())),
    "viewers": lambda demo, quick: video.measure_viewers(demo, 3 if quick else video.VIEWERS_SECONDS),
    "fan_out": lambda demo, quick: fan_out.measure(demo, 6 if quick else fan_out.SECONDS),
    "beside_clouds": lambda demo, quick: fan_out.measure_beside(demo, 5 if quick else fan_out.DRIVEN_S),
    "input_latency": lambda demo, quick: drive_page.measure_input(demo, 5 if quick else drive_page.PRESSES),
    "drive_page": lambda demo, quick: drive_page.measure(demo, 3 if quick else drive_page.SECONDS),
    "recovery": lambda _, quick: recovery.measure(2 if quick else recovery.REPEAT),
    "stopping": lambda demo, quick: stopping.measure(demo, 1 if quick else 10),
    "operations_rate": lambda _demo, _quick: operations_rate.measure(),
    "recording": lambda _, quick: recording.measure(5 if quick else recording.SECONDS),
    "audit_verify": lambda _, quick: audit_verify.measure(10_000 if quick else audit_verify.LINES),
    "agent_memory": lambda _demo, _quick: agent_memory.measure(),
}  # fmt: skip


def circumstances() -> str:
    here = machine()
    return wrapped(
        f"Measured on {datetime.now(UTC):%Y-%m-%d} at commit {commit()}, all on one machine: "
        f"{here['processor']}, {here['cores']} cores, Linux {here['kernel']}, Python "
        f"{platform.python_version()}, load {os.getloadavg()[0]:.1f} at the start."
    )


def names_of(text: str) -> list[str]:
    chosen = text.split(",")
    for name in chosen:
        if name not in EXPERIMENTS:
            known = ", ".join(EXPERIMENTS)
            raise argparse.ArgumentTypeError(f"there is no experiment {name}; there are {known}")
    return [name for name in EXPERIMENTS if name in chosen]


def write_part(name: str, section: Section, measured: str) -> None:
    """Replace a part of the page, at once, as a later experiment may fail; of one that is no more there is no part."""
    pieces = _MARK.split(PAGE.read_text())[1:] if PAGE.exists() else []
    known = dict(zip(pieces[::2], pieces[1::2], strict=True))
    known[name] = f"{section.markdown}\n{measured}"
    parts = [
        f"<!-- experiment: {item} -->\n{known[item].strip()}\n"
        for item in EXPERIMENTS
        if item in known
    ]
    PAGE.write_text("\n".join([HEAD, *parts]))


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument(
        "--only", type=names_of, default=list(EXPERIMENTS), help="run these, separated by commas"
    )
    arguments.add_argument("--quick", action="store_true", help="repeat less, write nothing")
    chosen = arguments.parse_args()
    demo = Demo()
    for name in chosen.only:
        sys.stderr.write(f"bench: {name}\n")
        measured = circumstances()
        section = EXPERIMENTS[name](demo, chosen.quick)
        sys.stdout.write(section.markdown + "\n")
        sys.stdout.flush()
        if not chosen.quick:
            write_part(name, section, measured)


if __name__ == "__main__":
    main()
