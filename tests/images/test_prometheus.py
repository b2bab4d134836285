"""Prometheus' rules, as the image's own promtool reads them, and the image with nothing of a site's around it."""

from __future__ import annotations

import subprocess
import time
from pathlib import Path

import pytest
from image_names import image

TESTS = Path(__file__).with_name("prometheus_rules.yml")
LOCKED_DOWN = ("--read-only", "--cap-drop", "ALL", "--network", "none")
START_WITHIN_S = 60


def run(*arguments: str) -> str:
    done = subprocess.run(
        ["docker", *arguments], capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout.strip()


@pytest.mark.parametrize(
    "arguments",
    [
        ("check", "config", "/etc/prometheus/prometheus.yml"),
        ("test", "rules", "/etc/prometheus/tests.yml"),
    ],
)
def test_promtool_is_content(arguments: tuple[str, ...]) -> None:
    """Each alert comes from its fault, and from nothing else."""
    mount = f"type=bind,source={TESTS},target=/etc/prometheus/tests.yml,readonly"
    promtool = ("--entrypoint", "promtool", image("prometheus"), *arguments)
    # Where promtool keeps what it tests.
    run("run", "--rm", *LOCKED_DOWN, "--tmpfs", "/tmp", "--mount", mount, *promtool)


def test_it_starts_without_a_relay_and_without_rights() -> None:
    container = run("run", "--detach", *LOCKED_DOWN, image("prometheus"))
    try:
        give_up_at = time.monotonic() + START_WITHIN_S
        check = ["docker", "exec", container, "/usr/lib/robotether/healthy"]
        while subprocess.run(check, check=False, timeout=30).returncode:
            assert time.monotonic() < give_up_at, run("logs", container)
            time.sleep(0.5)
    finally:
        run("rm", "--force", "--volumes", container)
