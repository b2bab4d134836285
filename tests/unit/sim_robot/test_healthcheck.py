"""The health check asks both servers."""

import asyncio

import pytest
from sim_robot import healthcheck
from sim_robot.simulator import Simulator


@pytest.fixture
def environment(simulator: Simulator, monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Settings that lead to the running simulator."""
    monkeypatch.setenv("SIM_ROSBRIDGE_PORT", str(simulator.rosbridge.listener.port))
    monkeypatch.setenv("SIM_VIDEO_PORT", str(simulator.video.listener.port))
    return monkeypatch


async def test_healthy(environment: pytest.MonkeyPatch) -> None:
    """Both answer: 0."""
    assert await asyncio.to_thread(healthcheck.main) == 0


@pytest.mark.parametrize("missing", ["rosbridge", "video"])
async def test_one_server_gone(
    simulator: Simulator,
    environment: pytest.MonkeyPatch,
    missing: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """One of both does not answer: 1, and why."""
    await getattr(simulator, missing).listener.stop()
    assert await asyncio.to_thread(healthcheck.main) == 1
    assert "refused" in capsys.readouterr().err


async def test_wrong_server_on_the_port(
    simulator: Simulator, environment: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Something else on rosbridge's port is told apart."""
    environment.setenv("SIM_ROSBRIDGE_PORT", str(simulator.video.listener.port))
    assert await asyncio.to_thread(healthcheck.main) == 1
    assert "rosbridge answers 200 and not 101" in capsys.readouterr().err


async def test_wrong_settings(
    environment: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Settings that cannot be read are unhealthy too."""
    environment.setenv("SIM_VIDEO_PORT", "x")
    assert await asyncio.to_thread(healthcheck.main) == 1
    assert "SIM_VIDEO_PORT" in capsys.readouterr().err
