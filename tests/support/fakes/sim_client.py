"""What tests of the simulated robot have: its settings on free ports, and waits for what is seen elsewhere."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from sim_robot.settings import SimSettings

WAIT_S = 30.0
SETTINGS = SimSettings(name="test", bind_address="127.0.0.1", rosbridge_port=0, video_port=0)


async def until(what: str, condition: Callable[[], bool], seconds: float = WAIT_S) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"after {seconds} s still not: {what}"
        await asyncio.sleep(0.005)
