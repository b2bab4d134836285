"""Robots that a test has taken away, or whose server: the next test is to find them as it expects."""

from __future__ import annotations

from functools import partial
from http import HTTPStatus

from stack import Stack

# An agent that was kept out asks again within 30 s, and opens the way for its pictures after that for its commands.
BACK_WITHIN_S = 90


def wait_until_back(stack: Stack, *robots: str) -> None:
    """Wait until each robot is online, its guard takes commands, and its camera is seen."""
    for robot in robots:
        is_back = partial(_is_back, stack, robot)
        stack.wait(f"{robot} back", is_back, robot, "sshd", "relay", seconds=BACK_WITHIN_S)


def _is_back(stack: Stack, robot: str) -> bool:
    try:
        status, control = stack.admin.try_to("GET", f"/robots/{robot}/control")
        if status != HTTPStatus.OK or control["guard"] != "ready":
            return False
        return stack.admin.sees(f"/robots/{robot}/video/snapshot?topic=/camera/image_raw")
    except OSError:
        return False
