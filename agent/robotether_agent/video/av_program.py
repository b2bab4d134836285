"""What a process with PyAV does first, so that it never takes the processor or the memory from the guard."""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import sys
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

NICENESS = 10
# Maximum memory in bytes that is not shared with other programs: enough for 1920x1080, and not for 3840x2160.
MAX_DATA_BYTES = 192 * 1024 * 1024
PR_SET_PDEATHSIG = 1
# Flag of FFmpeg's decoders (AV_CODEC_FLAG_LOW_DELAY): no frame waits for the next.
LOW_DELAY_FLAG = 0x80000
# FFmpeg's numbers of the ranges of colours.
LIMITED, FULL = 1, 2


def step_back() -> None:
    """Leave processor and memory to the robot, and end with the agent."""
    # Ctrl-C at a terminal is for the agent, which ends this.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(NICENESS)
    resource.setrlimit(resource.RLIMIT_DATA, (MAX_DATA_BYTES, MAX_DATA_BYTES))
    # The first that the kernel ends for want of memory.
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000")
    # Its standard input, which also ends with the agent, is not read while it works.
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


def private_output() -> BinaryIO:
    """Return standard output, on which libraries then print no more."""
    output = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    return output
