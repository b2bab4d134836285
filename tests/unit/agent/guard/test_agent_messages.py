"""The agent's lines."""

from __future__ import annotations

import json
from typing import Any

import pytest
from robotether_agent.fields import FieldError
from robotether_agent.guard.agent_messages import (
    AgentMessage,
    Exit,
    GuardConfig,
    Lease,
    Release,
    SessionIs,
    Stop,
    Tick,
    parse,
)

URL = "ws://127.0.0.1:9090"


def read(**line: Any) -> AgentMessage | None:
    return parse(json.dumps(line).encode())


@pytest.mark.parametrize(
    ("line", "order"),
    [
        ({"type": "tick"}, Tick()),
        ({"type": "exit"}, Exit()),
        ({"type": "session", "up": True}, SessionIs(up=True)),
        ({"type": "lease", "fence": 13, "held": True}, Lease(13, held=True)),
        ({"type": "stop", "id": "5f", "by": "ben"}, Stop("5f", "ben")),
        ({"type": "stop"}, Stop("", "")),
        ({"type": "release", "id": "77", "by": "ann"}, Release("77", "ann")),
        ({"type": "of tomorrow"}, None),
    ],
)
def test_each_line_is_one_order(line: dict[str, Any], order: AgentMessage | None) -> None:
    """A stop counts without its members, a release does not."""
    assert read(**line) == order


def test_a_configuration_has_defaults() -> None:
    """As docs/protocols.md gives them; without a key nobody gets in."""
    config = read(type="config", rosbridge_url=URL, guard={}, direct=False)
    assert isinstance(config, GuardConfig)
    assert (config.key, config.deadman_s, config.max_age_s) == ("", 0.5, 0.5)
    assert config.topics.patterns == ("/cmd_vel", "*/cmd_vel")
    assert config.limits.max_speed_m_s is None


def test_a_configuration_is_read_whole() -> None:
    """Times in ms, limits or null, and no key in a text for people."""
    guard = {
        "key": "secret", "drive_topics": ["/vel"], "deadman_ms": 200, "max_age_ms": 2000, "max_speed_m_s": 1,
        "max_turn_rad_s": 2.5, "max_acceleration_m_s2": None, "max_turn_acceleration_rad_s2": 4,
        "max_steering_rad": 0.5,
    }  # fmt: skip
    config = read(type="config", rosbridge_url=URL, guard=guard, direct=True)
    assert isinstance(config, GuardConfig)
    assert (config.key, config.deadman_s, config.max_age_s, config.direct) == (
        "secret",
        0.2,
        2.0,
        True,
    )
    assert (config.limits.max_speed_m_s, config.limits.max_turn_rad_s) == (1.0, 2.5)
    assert config.limits.max_acceleration_m_s2 is None
    assert (config.limits.max_turn_acceleration_rad_s2, config.limits.max_steering_rad) == (
        4.0,
        0.5,
    )
    assert "secret" not in repr(config)


def test_a_robot_may_have_no_drive_topics() -> None:
    config = read(type="config", rosbridge_url=URL, guard={"drive_topics": []})
    assert isinstance(config, GuardConfig)
    assert config.topics.patterns == ()


@pytest.mark.parametrize(
    "guard",
    [
        {"deadman_ms": 199}, {"deadman_ms": 2001}, {"max_age_ms": "500"}, {"drive_topics": "x"},
        {"drive_topics": ["/a[b]"]}, {"max_speed_m_s": -1}, {"max_speed_m_s": "fast"}, {"key": 3},
    ],
)  # fmt: skip
def test_a_wrong_setting_names_itself(guard: dict[str, Any]) -> None:
    with pytest.raises(FieldError, match=next(iter(guard))):
        read(type="config", rosbridge_url=URL, guard=guard)


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"[]",
        b"{}",
        b'{"type":"lease"}',
        b'{"type":"lease","fence":-1}',
        b'{"type":"config"}',
        b"\xff",
    ],
)
def test_a_broken_line_is_no_order(line: bytes) -> None:
    with pytest.raises(FieldError):
        parse(line)
