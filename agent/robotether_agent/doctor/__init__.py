"""Runs every check from the settings to the end-to-end path, in the order in which a connection needs them.

For `robotether-agent doctor`. It changes nothing on the robot, joins nothing, and logs in nowhere.
"""

from __future__ import annotations

import time
from collections.abc import AsyncIterator
from datetime import datetime, timezone

from robotether_agent import systemd
from robotether_agent.doctor import machine, server, tunnel
from robotether_agent.doctor.findings import Finding, ok
from robotether_agent.settings import Settings
from robotether_agent.status import is_alive, read_status


async def run_checks(settings: Settings) -> AsyncIterator[Finding]:
    """Yield what each check finds, as soon as it is known."""
    status = read_status(settings.run_dir)
    if status is not None and not is_alive(status, time.time()):
        status = None
    yield ok("settings", f"server = {settings.server}")
    yield machine.check_disk(settings)
    yield machine.check_mac(settings)
    yield await machine.check_key(settings)
    seen = await server.view_server(settings)
    pinned = settings.tls_fingerprint
    yield server.check_name(seen)
    yield server.check_port(seen)
    yield server.check_certificate(seen, pinned)
    yield server.check_clock(seen, datetime.now(timezone.utc), is_pinned=pinned is not None)
    yield server.check_answer(seen)
    yield tunnel.check_join(settings, status)
    for finding in await tunnel.check_ssh(settings):
        yield finding
    yield tunnel.check_service(systemd.state(), status)
    yield await machine.check_rosbridge(settings)
    yield tunnel.check_guard(settings, status)
    yield await machine.check_video(settings)
    yield await machine.check_shell(settings)
    yield tunnel.check_session(status)
    yield tunnel.check_end_to_end(status)
