"""A bare `ssh -R` of a robot: both ways stand while it is entered, and nothing is left behind."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import aiohttp
import pytest
from link import why_not_here
from openssh_server import command_line, descendants, listens, wait_until
from paper.operators_bare import VIDEO_PORT, bare_tunnels
from paper.profiles import PLAIN
from paper.robots import clean_environment
from paper.uplinks import uplinks

pytestmark = pytest.mark.skipif(bool(why_not_here()), reason=why_not_here() or "-")
ADDRESS = "127.9.9.1"
STARTS_WITHIN_S = 30.0


@pytest.fixture
def robot() -> Iterator[Any]:
    """What a tunnel needs of a robot: a network with a simulated one in it, without an agent."""
    environ = {**clean_environment(), "SIM_BIND_ADDRESS": ADDRESS, "SIM_LOG_LEVEL": "error"}
    with uplinks([PLAIN], "127.0.0.1") as [made]:
        # The address that this machine has on the cable between.
        made.machine = made.inside.run("ip", "-4", "route", "show", "default").split()[2]
        command = made.inside.command(sys.executable, "-m", "sim_robot")
        with subprocess.Popen(command, env=environ) as simulator:
            try:
                with made.inside.entered():
                    wait_until(
                        lambda: listens(VIDEO_PORT, ADDRESS),
                        lambda: "the simulated robot's video answers",
                        STARTS_WITHIN_S,
                    )
                yield SimpleNamespace(name="robot", address=ADDRESS, uplink=made)
            finally:
                simulator.terminate()


async def test_both_services_are_there_and_then_gone(robot: Any) -> None:
    """Rosbridge and video at a port of this machine each; sshd, ssh and ports end with the block."""
    with bare_tunnels([robot]) as [ports]:
        async with aiohttp.ClientSession() as http:
            async with http.get(f"http://127.0.0.1:{ports.video}/") as answer:
                assert "/camera/image_raw" in await answer.text()
            async with http.ws_connect(f"ws://127.0.0.1:{ports.ros}/") as rosbridge:
                await rosbridge.send_json({"op": "call_service", "service": "/rosapi/nodes"})
                assert (await rosbridge.receive_json())["result"]
    assert not listens(ports.ros)
    assert not listens(ports.video)
    assert not [pid for pid in descendants(os.getpid()) if "ssh" in command_line(pid)]
