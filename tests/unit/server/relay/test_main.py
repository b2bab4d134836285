"""The relay as a process: settings that stop the start, and signals that stop the relay."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys

from fake_robot import HOST
from relay_server import relay_settings, until
from robotether_server.relay.main import run
from robotether_server.relay.relay import Listen


def test_a_missing_setting_stops_the_start_with_a_sentence():
    """Without its variables the process ends with the name of the first one, and no traceback."""
    environment = {"PATH": os.environ["PATH"], "PYTHONPATH": os.pathsep.join(sys.path)}
    result = subprocess.run(
        [sys.executable, "-m", "robotether_server.relay"],
        env=environment,
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )
    assert result.returncode == 1
    assert result.stderr.startswith("cannot ")
    assert "Traceback" not in result.stderr


async def test_sigterm_stops_it(caplog):
    """It starts without a database, and ends when it is told to."""
    caplog.set_level("INFO")
    listen = Listen(host=HOST, http_port=0, session_port=0, inside_port=0)
    running = asyncio.create_task(run(relay_settings(), listen))
    await until(lambda: "listening on" in caplog.text, "it listens")
    os.kill(os.getpid(), signal.SIGTERM)
    async with asyncio.timeout(3):
        await running
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().remove_signal_handler(number)
