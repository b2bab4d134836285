"""The robot that tests of the relay start."""

from __future__ import annotations

import asyncio

import pytest
from fake_robot import HOST, FakeRobot
from relay_server import SESSION_KEY, MemoryDatabase, running_relay


async def test_a_robot_that_is_stopped_as_its_session_ends_leaves_no_port_open() -> None:
    """Whichever of the two closes them: a loop with something open may never end."""
    records = MemoryDatabase()
    row = records.add_robot(7, "sim1")
    async with running_relay(records) as relay:
        robot = FakeRobot(row.id, SESSION_KEY)
        await robot.start(relay.relay.session_port)
        await robot.session.close()
        await robot.stop()
        for port in (row.ros_port, row.video_port):
            with pytest.raises(ConnectionRefusedError):
                await asyncio.open_connection(HOST, port)
