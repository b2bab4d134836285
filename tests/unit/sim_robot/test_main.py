"""The program starts, answers its health check and ends on a signal."""

import asyncio
import os
import re
import signal
import sys
from pathlib import Path

import pytest
import sim_robot
from sim_client import WAIT_S, SocketClient

FOLDER = Path(sim_robot.__file__).parents[1]
FREE = {"SIM_BIND_ADDRESS": "127.0.0.1", "SIM_ROSBRIDGE_PORT": "0", "SIM_VIDEO_PORT": "0"}


async def start(module: str, **variables: str) -> asyncio.subprocess.Process:
    """Run one of the package's programs."""
    return await asyncio.create_subprocess_exec(
        sys.executable, "-m", module, cwd=FOLDER, stderr=asyncio.subprocess.PIPE,
        env={**os.environ, "SIM_NAME": "test", **variables},
    )  # fmt: skip


async def ports(process: asyncio.subprocess.Process) -> list[int]:
    """Read the ports of rosbridge and video from the log."""
    assert process.stderr is not None
    found: list[int] = []
    while len(found) < 2:
        line = (await asyncio.wait_for(process.stderr.readline(), WAIT_S)).decode()
        assert line, "the program ended"
        found += [int(port) for port in re.findall(r"listens on [\d.]+:(\d+)", line)]
    return found


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
async def test_signal_ends_it_with_a_client_connected(number: signal.Signals) -> None:
    """With a client and a signal it ends soon, with code 0."""
    process = await start("sim_robot", **FREE)
    rosbridge, _ = await ports(process)
    async with SocketClient(rosbridge) as client:
        await client.ready()
        process.send_signal(number)
        _, errors = await asyncio.wait_for(process.communicate(), WAIT_S)
    assert process.returncode == 0, errors.decode()
    assert "Traceback" not in errors.decode()


async def test_wrong_setting_stops_the_start() -> None:
    """The sentence is on stderr, the exit code is that of a wrong configuration."""
    process = await start("sim_robot", SIM_ROS_VERSION="3")
    _, errors = await asyncio.wait_for(process.communicate(), WAIT_S)
    assert process.returncode == 78
    assert errors.decode() == "cannot start: SIM_ROS_VERSION is '3', allowed is 1 or 2\n"


async def test_taken_port_is_told() -> None:
    """A port in use is an error in a sentence, without a traceback."""
    first = await start("sim_robot", **FREE)
    rosbridge, _ = await ports(first)
    second = await start("sim_robot", **FREE | {"SIM_ROSBRIDGE_PORT": str(rosbridge)})
    _, errors = await asyncio.wait_for(second.communicate(), WAIT_S)
    assert second.returncode == 1
    assert "address already in use" in errors.decode()
    assert "Traceback" not in errors.decode()
    first.terminate()
    await asyncio.wait_for(first.communicate(), WAIT_S)
