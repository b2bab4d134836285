"""What doctor says of the encoder of video."""

from __future__ import annotations

import sys
from dataclasses import replace

import pytest
from robotether_agent.doctor import OK, SKIPPED, WARNING
from robotether_agent.doctor import encoder as check
from robotether_agent.settings import Settings
from robotether_agent.video.encoder import VideoEncoder

SETTINGS = Settings(server="cloud.example")


async def test_encoder_is_named_once_it_has_encoded_a_frame(monkeypatch):
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    finding = await check.check_encoder(SETTINGS)
    assert finding.state == OK
    assert "libx264 encodes H.264" in finding.detail


@pytest.mark.parametrize(
    ("setting", "cores", "state", "reason"),
    [
        ("off", 2, SKIPPED, "video_encoder is off"),
        ("auto", 1, SKIPPED, "one processor core"),
        ("auto", 2, WARNING, "the encoder ended: exit code 3"),
    ],
)
async def test_robot_without_an_encoder_is_told_why(monkeypatch, setting, cores, state, reason):
    monkeypatch.setattr("os.cpu_count", lambda: cores)
    command = (sys.executable, "-c", "raise SystemExit(3)")
    monkeypatch.setattr(check, "VideoEncoder", lambda *how: VideoEncoder(*how, command))
    finding = await check.check_encoder(replace(SETTINGS, video_encoder=setting))
    assert finding.state == state
    assert "so video is JPEG" in finding.detail
    assert reason in finding.detail
