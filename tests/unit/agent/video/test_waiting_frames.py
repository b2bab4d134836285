"""Which frames wait for credit: of JPEG the newest, of H.264 each in its turn from a key frame on."""

from __future__ import annotations

import pytest
from robotether_agent.video.sources import CameraFrame, SourceRequest
from robotether_agent.video.waiting_frames import HELD_S, MAX_WAITING, NewFrame, WaitingFrames
from robotether_common.codecs import H264, JPEG

REQUEST = SourceRequest("/camera", 80, None, None, 15.0)


def put(waiting: WaitingFrames, kinds: str, *, at_s: float = 0.0, step_s: float = 0.0) -> None:
    """Let frames wait by their kind, a letter each: J of JPEG, K a key frame, F another one of H.264."""
    for kind in kinds:
        codec = JPEG if kind == "J" else H264
        frame = CameraFrame(kind.encode(), at_s, at_s, codec=codec, is_key=kind == "K")
        waiting.put(NewFrame(0, frame, REQUEST), at_s)
        at_s += step_s


def taken(waiting: WaitingFrames) -> str:
    frames = iter(waiting.next, None)
    return b"".join(new.frame.data for new in frames).decode()


@pytest.mark.parametrize(
    ("kinds", "sent"),
    [
        ("JJJ", "J"),
        ("KFF", "KFF"),
        # What can be decoded without them replaces those that wait.
        ("KFFKF", "KF"),
        ("FFF", ""),
        ("FFKF", "KF"),
        ("KFJ", "J"),
        ("JFF", ""),
    ],
)
def test_frames_wait_so_that_each_can_be_decoded(kinds, sent):
    waiting = WaitingFrames()
    put(waiting, kinds)
    assert taken(waiting) == sent


@pytest.mark.parametrize(("kinds", "step_s"), [("KFFF", HELD_S), ("K" + "F" * MAX_WAITING, 0.0)])
def test_frames_that_wait_too_long_leave_room_for_the_next_key_frame(kinds, step_s):
    waiting = WaitingFrames()
    put(waiting, kinds, step_s=step_s)
    assert taken(waiting) == ""
    put(waiting, "FKF", at_s=9.0)
    assert taken(waiting) == "KF"


def test_frames_of_another_request_do_not_continue_those_before():
    waiting = WaitingFrames()
    put(waiting, "KF")
    other = SourceRequest("/camera", 50, None, None, 15.0)
    waiting.put(NewFrame(0, CameraFrame(b"F", 0.0, 0.0, codec=H264), other), 0.0)
    assert taken(waiting) == ""


def test_a_robot_that_makes_no_key_frames_is_named():
    waiting = WaitingFrames()
    put(waiting, "FFF", at_s=10.0, step_s=1.0)
    assert waiting.lack(11.9) == ""
    assert "no key frame for 3 s" in waiting.lack(13.0)
    put(waiting, "K", at_s=13.0)
    assert waiting.lack(20.0) == ""
