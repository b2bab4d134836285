"""The first process of the agent's container, with doubles of agent and guard: it must outlive both."""

import os
import signal
import subprocess
from pathlib import Path

import pytest
from commands import path_with, run_command, write_programs
from openssh_server import wait_until
from robotether_agent.guard.fork_server import GUARD_NAME

ENTRYPOINT = Path(__file__).resolve().parents[3] / "images" / "agent" / "entrypoint"
# In place of `python3 -m robotether_agent run`: the guard is left behind when the agent is killed.
AGENT = f"""#!/bin/bash
(echo {GUARD_NAME} > /proc/self/comm; echo $$ > "$PLACE/agent"; sleep 0.8; touch "$PLACE/robot-stopped") &
exec sleep 30
"""


def test_outlives_the_guard_of_a_killed_agent(tmp_path):
    write_programs(tmp_path, {"python3": AGENT})
    environ = {**os.environ, **path_with(tmp_path), "PLACE": str(tmp_path)}
    with subprocess.Popen([ENTRYPOINT, "run"], env=environ) as first:
        agent = tmp_path / "agent"
        wait_until(lambda: agent.exists() and agent.read_text(), lambda: "the agent runs")
        os.kill(int(agent.read_text()), signal.SIGKILL)
        assert first.wait(10) == 128 + signal.SIGKILL
    assert (tmp_path / "robot-stopped").exists()


# Writes what shows that it lives, and then only what shows that it was not killed.
HANGING = """#!/bin/bash
echo {} > "$ROBOTETHER_RUN_DIR/status.json"
[ -e "$ROBOTETHER_RUN_DIR/hangs" ] || while sleep 0.1; do echo {} > "$ROBOTETHER_RUN_DIR/status.json"; done &
sleep 3
kill $!
"""


@pytest.mark.parametrize(("hangs", "status"), [(True, 128 + signal.SIGKILL), (False, 0)])
def test_agent_that_hangs_is_ended(tmp_path, hangs, status):
    """Docker starts again what has ended, and systemd sees no further than the container."""
    write_programs(tmp_path, {"python3": HANGING})
    if hangs:
        (tmp_path / "hangs").touch()
    script = ENTRYPOINT.read_text().replace("LOOK_S=10", "LOOK_S=0.3")
    environ = {**os.environ, **path_with(tmp_path), "ROBOTETHER_RUN_DIR": str(tmp_path)}
    done = run_command("sh", "-c", script, "entrypoint", "run", env=environ)
    assert done.returncode == status


@pytest.mark.parametrize(
    ("code", "setting", "waits"), [(78, "yes", True), (78, "", False), (1, "yes", False)]
)
def test_agent_that_needs_a_person_is_not_started_again(tmp_path, code, setting, waits):
    """Where Docker starts it; systemd knows these statuses by itself."""
    write_programs(tmp_path, {"python3": f"exit {code}", "sleep": 'echo "sleeps $1"'})
    environ = {**os.environ, **path_with(tmp_path), "WAITS_FOR_PERSON": setting}
    environ["ROBOTETHER_RUN_DIR"] = str(tmp_path)
    script = ENTRYPOINT.read_text().replace("watch &", "true &")
    done = run_command("sh", "-c", script, "entrypoint", "run", env=environ)
    assert ("sleeps infinity" in done.stdout) == waits
    assert done.returncode == (0 if waits else code)
