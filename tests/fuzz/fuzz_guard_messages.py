"""Fuzzes what the guard reads from rosbridge's clients: any bytes, and by the properties of tests/unit.

Run as `python tests/fuzz/fuzz_guard_messages.py -max_total_time=60`; `test_fuzz.py` does so for some seconds.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path

import atheris

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / name) for name in ("common", "agent", "tests/unit/agent/guard")]
with atheris.instrument_imports(include=["robotether_common", "robotether_agent"]):
    import test_drive_messages as properties
    from robotether_agent.guard.drive_messages import DriveMessageUnclearError


def fuzz_one(data: bytes) -> None:
    """Check one input, as a message and as what hypothesis makes examples of."""
    with suppress(DriveMessageUnclearError):
        properties.read(data)
    properties.test_nothing_that_passes_can_drive.hypothesis.fuzz_one_input(data)
    properties.test_whatever_passes_is_finite_and_json.hypothesis.fuzz_one_input(data)


def main() -> None:
    # Short inputs are too few choices for a whole example.
    atheris.Setup([sys.argv[0], "-len_control=0", "-max_len=8192", *sys.argv[1:]], fuzz_one)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
