"""How a robot's rosbridge is reached, and what its guard is told."""

import pytest
from relay_clients import closing
from robotether_server.relay.robots import robot_dialer


@pytest.mark.parametrize(
    ("mode", "forward_within_s", "says"),
    [
        ("guard_refuses", None, "guard"),
        # The try that is cut short has no answer, and those before it had one.
        ("guard_refuses", 60.0, "guard"),
        ("guard_says_why", None, "sim1 does not answer: the robot is stopped"),
        ("disk_full", None, "its guard cannot write to the robot's disk"),
    ],
)
async def test_who_is_refused_by_the_guard_hears_why(
    *, relay, start_robot, sim1, monkeypatch, mode, forward_within_s, says, ros
):
    """No lease is left; where retrying does not help, nobody retries."""
    if forward_within_s is not None:
        monkeypatch.setattr(robot_dialer, "FORWARD_WITHIN_S", forward_within_s)
        monkeypatch.setattr(robot_dialer, "MIN_CONNECT_TIMEOUT_S", 1.0)
    robot = await start_robot(relay, mode)
    async with ros() as socket:
        code, reason = await closing(socket)
    assert code == 4504
    assert says in reason
    assert relay.relay.control.driver(sim1.id) is None
    assert (len(robot.handshakes) == 1) == (mode == "disk_full")
