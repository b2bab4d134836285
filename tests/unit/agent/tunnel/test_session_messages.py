"""The session's lines about driving, one by one."""

from __future__ import annotations

from typing import Any

import pytest
from robotether_agent.fields import FieldError
from robotether_agent.tunnel.session_messages import message_handlers


class Noted:
    """Notes what it is told to do."""

    def __init__(self) -> None:
        self.done: list[tuple[Any, ...]] = []

    def on_config(self, guard: Any, *, direct: bool) -> None:
        self.done.append(("configured", guard, direct))

    def on_lease(self, fence: int, *, held: bool) -> None:
        self.done.append(("lease", fence, held))

    def on_stop(self, message_id: str, by: str) -> None:
        self.done.append(("stop", message_id, by))

    def on_release(self, message_id: str, by: str) -> None:
        self.done.append(("release", message_id, by))


@pytest.mark.parametrize(
    ("line", "done"),
    [
        ({"type": "lease", "fence": 13, "held": True}, ("lease", 13, True)),
        ({"type": "lease", "fence": 13}, ("lease", 13, False)),
        ({"type": "stop", "id": "5f0c", "by": "ben"}, ("stop", "5f0c", "ben")),
        ({"type": "stop"}, ("stop", "", "somebody")),
        ({"type": "release", "id": "77aa", "by": "ann"}, ("release", "77aa", "ann")),
    ],
)
def test_each_line_is_done_as_it_says(line, done):
    """What is missing is read in the way that stops the robot."""
    noted = Noted()
    message_handlers(noted)[line["type"]](line)
    assert noted.done == [done]


@pytest.mark.parametrize(
    "line",
    [
        {"type": "lease", "fence": -1, "held": True},
        {"type": "lease", "held": True},
        {"type": "lease", "fence": 2**63, "held": True},
        {"type": "lease", "fence": 1, "held": "yes"},
        {"type": "release"},
        {"type": "release", "id": "with blank"},
    ],
)
def test_broken_lines_do_nothing(line):
    """Nothing that would let somebody drive is guessed."""
    noted = Noted()
    with pytest.raises(FieldError):
        message_handlers(noted)[line["type"]](line)
    assert noted.done == []
