"""Who may connect and stay, and what a new row means for a live link, without a network."""

from dataclasses import replace

import pytest
from robotether_server.db.fleet import RelayRobot, Snapshot
from robotether_server.relay.robots.authorization import NotAuthorizedError, authorize, needs_config
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


def refusal(robot, **preface):
    fields = {"kind": "session", "robot_id": 7, "address": "", "fingerprint": "SHA256:new"}
    try:
        authorize(Snapshot({robot.id: robot}, {}), Preface(**{**fields, "ports": MINE, **preface}))
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
        (replace(SIM1, state="pending"), {"fingerprint": "SHA256:x"}, "robot_disabled"),
        (replace(SIM1, fingerprint=None, previous_fingerprint=None), {}, "key_changed"),
        (replace(SIM1, shell_port=None), {"kind": "session"}, "ports_changed"),
        (replace(SIM1, ros_port=20002), {}, "ports_changed"),
        (replace(SIM1, shell_port=24001), {"kind": "shell"}, "ports_changed"),
    ],
)
def test_who_is_admitted(robot, preface, code):
    """The transcript of byes has the others."""
    assert refusal(robot, **preface) == code


@pytest.mark.parametrize(
    ("before", "change", "told"),
    [
        (SIM1, {}, False),
        (SIM1, {"name": "turtle"}, True),
        (SIM1, {"rotate_key": True}, True),
        (SIM1, {"agent_version": "9"}, False),
        (SIM1, {"fingerprint": "SHA256:newer"}, False),
        (SIM1, {"settings": parse({"guard": {"deadman_ms": 300}})}, True),
        (SIM1, {"settings": parse({"page": {"battery_unit": "percent"}})}, True),
        (SIM1, {"settings": parse({"page": {"odometry_topic": "/odom2"}})}, True),
        (SIM1, {"settings": parse({"policy": {"drive": {"call": ["*"]}}})}, False),
        # A first shell port takes no port away from a login.
        (replace(SIM1, shell_port=None), {"shell_port": 24000}, True),
        # Sshd fixes at the login what a connection may listen on.
        (SIM1, {"ros_port": 20002}, "ports_changed"),
        (SIM1, {"video_port": 20003}, "ports_changed"),
        (SIM1, {"ros_port": 20001, "video_port": 20000}, "ports_changed"),
        (SIM1, {"shell_port": None}, "ports_changed"),
        (SIM1, {"shell_port": 24001}, "ports_changed"),
    ],
)
def test_what_is_told_to_a_live_link(before, change, told):
    """Whether it gets its configuration anew; a port that is taken away needs a new login."""
    try:
        found = needs_config(before, replace(before, **change))
    except NotAuthorizedError as refused:
        found = refused.code
    assert found == told
