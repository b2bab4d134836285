"""The health check of sshd's container, with what may answer at its ports: what is unhealthy is replaced."""

import asyncio
from pathlib import Path

import pytest
from ssh_ports import SshPort

HEALTHY = Path(__file__).resolve().parents[3] / "images" / "sshd" / "healthy"


async def is_healthy(folder, plain, through_nginx):
    """Run the check with these two ports, and with programs beside sshd that are at work."""
    for program in ("jump-watch", "tunnel-watch", "key-lookups"):
        (folder / program).mkdir()
        (folder / program / "alive").touch()
    async with SshPort(plain) as first, SshPort(through_nginx) as second:
        check = HEALTHY.read_text()
        for ours, theirs in (
            ("2222", first.port),
            ("2223", second.port),
            ("/run/robotether", folder),
        ):
            check = check.replace(ours, str(theirs))
        done = await asyncio.create_subprocess_exec("bash", "-c", check)
        return await asyncio.wait_for(done.wait(), 10) == 0


@pytest.mark.parametrize(
    ("plain", "through_nginx", "healthy"),
    [
        # Half-open connections, or a fleet that comes back, must not end the tunnels that are there.
        ("full", "full", True),
        # Nginx takes the header off before sshd speaks.
        ("speaks", "shy", True),
        ("closes", "speaks", False),
        # An sshd which nginx does not reach.
        ("speaks", "closes", False),
    ],
)
async def test_sshd_is_healthy_that_answers_or_is_full(tmp_path, plain, through_nginx, healthy):
    assert await is_healthy(tmp_path, plain, through_nginx) is healthy
