"""`robotether-agent status`: tells a person, or with --json a program, how the running agent is."""

from __future__ import annotations

import json
import time
from dataclasses import asdict

from robotether_agent.settings import Settings
from robotether_agent.status import CONNECTED, is_alive, read_status, render


def status(settings: Settings, *, as_json: bool) -> int:
    """Print the status, and return 0 only when the robot is connected."""
    found, now = read_status(settings.run_dir), time.time()
    alive = found is not None and is_alive(found, now)
    if as_json:
        print(json.dumps({**(asdict(found) if found else {}), "is_running": alive}))
    elif found is None:
        print(f"state         not running (no status in {settings.run_dir})")
        print("what to do    start it: sudo systemctl start robotether-agent")
    else:
        print(render(found, now))
    return 0 if found is not None and alive and found.state == CONNECTED else 1
