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


async def test_sshd_that_takes_no_more_log_ins_is_healthy(tmp_path):
    """Half-open connections, or a fleet that comes back, must not end the tunnels that are there."""
    assert await is_healthy(tmp_path, "full", "full")


async def test_sshd_that_shows_its_banner_is_healthy(tmp_path):
    """Nginx takes the header off before sshd speaks."""
    assert await is_healthy(tmp_path, "speaks", "shy")


@pytest.mark.parametrize(("plain", "through_nginx"), [("closes", "speaks"), ("speaks", "closes")])
async def test_port_without_sshd_is_unhealthy(tmp_path, plain, through_nginx):
    """Through nginx that is an sshd which nginx does not reach."""
    assert not await is_healthy(tmp_path, plain, through_nginx)
