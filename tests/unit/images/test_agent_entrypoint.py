"""The first process of the agent's container, with doubles of agent and guard: it must outlive the guard."""

import os
import signal
import subprocess
import time
from pathlib import Path

from robotether_agent.guard.fork_server import GUARD_NAME

ENTRYPOINT = Path(__file__).resolve().parents[3] / "images" / "agent" / "entrypoint"
# In place of `python3 -m robotether_agent run`: the guard is left behind when the agent is killed.
AGENT = f"""#!/bin/bash
(echo {GUARD_NAME} > /proc/self/comm; echo $$ > "$PLACE/agent"; sleep 0.8; touch "$PLACE/robot-stopped") &
exec sleep 30
"""


def test_outlives_the_guard_of_a_killed_agent(tmp_path):
    python = tmp_path / "python3"
    python.write_text(AGENT)
    python.chmod(0o755)
    environ = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}", "PLACE": str(tmp_path)}
    with subprocess.Popen([ENTRYPOINT, "run"], env=environ) as first:
        agent = tmp_path / "agent"
        end = time.monotonic() + 10
        while not (agent.exists() and agent.read_text()) and time.monotonic() < end:
            time.sleep(0.01)
        os.kill(int(agent.read_text()), signal.SIGKILL)
        assert first.wait(10) == 128 + signal.SIGKILL
    assert (tmp_path / "robot-stopped").exists()
