"""Who may connect and stay, and what a new row means for a live link, without a network."""

from __future__ import annotations

from dataclasses import replace

import pytest
from robotether_server.db.fleet import RelayRobot, Snapshot
from robotether_server.relay.robots.authorization import (
    NotAuthorizedError,
    authorize,
    needs_config,
    port_of,
)
from robotether_server.relay.robots.session_messages import Preface
from robotether_server.settings.robot import parse

SIM1 = RelayRobot(
    7,
    "sim1",
    "active",
    20000,
    20001,
    shell_port=24000,
    fingerprint="SHA256:new",
    previous_fingerprint="SHA256:old",
)
MINE = frozenset({20000, 20001, 24000})


def refusal(robot: RelayRobot | None, **preface: object) -> str | None:
    """The code of the refusal, None when it is admitted."""
    fields = {"kind": "session", "robot_id": 7, "address": "", "fingerprint": "SHA256:new"}
    robots = {} if robot is None else {robot.id: robot}
    try:
        authorize(Snapshot(robots, {}), Preface(**{**fields, "ports": MINE, **preface}))
    except NotAuthorizedError as refused:
        return refused.code
    return None


@pytest.mark.parametrize(
    ("robot", "preface", "code"),
    [
        (SIM1, {}, None),
        (SIM1, {"kind": "shell"}, None),
        (SIM1, {"fingerprint": "SHA256:old"}, None),
        (SIM1, {"ports": frozenset()}, None),
        (SIM1, {"fingerprint": ""}, "key_changed"),
        (SIM1, {"ports": frozenset({20000, 20001})}, None),
        (None, {}, "robot_unknown"),
        (replace(SIM1, state="disabled"), {}, "robot_disabled"),
        (replace(SIM1, state="pending"), {"fingerprint": "SHA256:x"}, "robot_disabled"),
        (SIM1, {"fingerprint": "SHA256:x"}, "key_changed"),
        (replace(SIM1, fingerprint=None, previous_fingerprint=None), {}, "key_changed"),
        (replace(SIM1, shell_port=None), {"kind": "shell"}, "shell_off"),
        (replace(SIM1, shell_port=None), {"kind": "session"}, "ports_changed"),
        (replace(SIM1, ros_port=20002), {}, "ports_changed"),
        (replace(SIM1, shell_port=24001), {"kind": "shell"}, "ports_changed"),
    ],
)
def test_who_is_admitted(robot, preface, code):
    """By state, key, shell and the ports that the login may listen on, in this order."""
    assert refusal(robot, **preface) == code


@pytest.mark.parametrize(
    ("change", "needed"),
    [
        ({}, False),
        ({"name": "turtle"}, True),
        ({"rotate_key": True}, True),
        ({"agent_version": "9"}, False),
        ({"fingerprint": "SHA256:newer"}, False),
    ],
)
def test_what_is_told_to_a_live_link(change, needed):
    """A new name or request is; what the agent knows or need not know is not."""
    assert needs_config(SIM1, replace(SIM1, **change)) is needed


def test_a_first_shell_port_is_news():
    """It takes no port away from a login that is."""
    assert needs_config(replace(SIM1, shell_port=None), SIM1)


@pytest.mark.parametrize(
    "change",
    [
        {"ros_port": 20002},
        {"video_port": 20003},
        {"ros_port": 20001, "video_port": 20000},
        {"shell_port": None},
        {"shell_port": 24001},
    ],
)
def test_a_port_that_is_taken_away_needs_a_new_login(change):
    """Sshd fixes at the login what a connection may listen on."""
    with pytest.raises(NotAuthorizedError) as refused:
        needs_config(SIM1, replace(SIM1, **change))
    assert refused.value.code == "ports_changed"


def test_each_kind_has_its_port():
    """The port that must be free before a link of that kind is configured."""
    assert [port_of(kind, SIM1) for kind in ("session", "media", "shell")] == [20000, 20001, 24000]


def test_other_guard_settings_are_news_and_another_policy_is_not():
    """The robot is told what its guard holds commands to; the policy is the relay's."""
    assert needs_config(SIM1, replace(SIM1, settings=parse({"guard": {"deadman_ms": 300}})))
    assert not needs_config(
        SIM1, replace(SIM1, settings=parse({"policy": {"drive": {"call": ["*"]}}}))
    )
