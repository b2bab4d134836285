"""Starts a guard: `python -m robotether_agent.guard --state-dir DIR --run-dir DIR`; the agent does."""

import argparse
import asyncio
import os
from pathlib import Path

from robotether_agent.guard.process import run
from robotether_agent.systemd import set_up_log

if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="robotether-agent-guard", description=__doc__)
    parser.add_argument("--state-dir", type=Path, required=True, help="keeps the stop")
    parser.add_argument("--run-dir", type=Path, required=True, help="keeps the mark of motion")
    parser.add_argument("--log-level", default="info")
    arguments = parser.parse_args()
    set_up_log(arguments.log_level, os.environ)
    asyncio.run(run(arguments.state_dir, arguments.run_dir))
