"""Runs every fuzzer in this folder for a while; a finding is printed with the input that makes it."""

import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
SECONDS = 3
# Starting an instrumented program is slow on a machine that runs other tests.
START_S = 60
FUZZERS = sorted(HERE.glob("fuzz_*.py"))


@pytest.mark.parametrize("fuzzer", FUZZERS, ids=lambda path: path.stem)
def test_no_input_breaks_the_parser(fuzzer, tmp_path):
    done = subprocess.run(
        [
            sys.executable,
            str(fuzzer),
            f"-max_total_time={SECONDS}",
            "-rss_limit_mb=2048",
            "-timeout=10",
        ],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=SECONDS + START_S,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    assert "Done " in done.stderr
