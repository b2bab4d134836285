"""Starts a guard on standard input and output, or the fork server of an agent whose socket is standard input."""

import argparse
import os
import socket
import sys
from functools import partial
from pathlib import Path

from robotether_agent import certificates  # noqa: F401 - before all that imports aiohttp
from robotether_agent.guard import fork_server, process
from robotether_agent.systemd import set_up_log

if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="robotether-agent-guard", description=__doc__)
    parser.add_argument("--state-dir", type=Path, required=True, help="keeps the stop")
    parser.add_argument("--run-dir", type=Path, required=True, help="keeps the mark of motion")
    parser.add_argument("--log-level", default="info")
    parser.add_argument("--fork-server", action="store_true")
    arguments = parser.parse_args()
    set_up_log(arguments.log_level, os.environ)
    run_guard = partial(process.main, arguments.state_dir, arguments.run_dir)
    if arguments.fork_server:
        fork_server.serve(socket.socket(fileno=0), run_guard)
    sys.exit(run_guard())
