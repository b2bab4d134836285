"""`robotether-agent switch DIRECTORY`: puts another installed version in the place of this one.

Run as root by the version that is in use, best under systemd-run: it outlives the loss of the very tunnel
through which somebody asked for it. `finish-switch` is for the unit that does it again after a power cut.
"""

from __future__ import annotations

import signal
from pathlib import Path

from robotether_agent.settings import Settings
from robotether_agent.upgrade import Upgrade
from robotether_agent.versions import Layout, Report


def switch(settings: Settings, directory: Path, wait_s: float) -> int:
    """Switch, print what came of it, and return 0 only when the other version is in use."""
    # The terminal that asked may go away with the tunnel.
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    target = directory.absolute()
    return _print_report(Upgrade(Layout(target.parent.parent), settings.run_dir, wait_s).to(target))


def finish_switch(settings: Settings, was: Path, target: Path, state: str, wait_s: float) -> int:
    """Switch from `was` to `target` again; `state` is how the agent was before."""
    change = Upgrade(Layout(target.parent.parent), settings.run_dir, wait_s)
    return _print_report(change.finish(was, target, state))


def _print_report(report: Report) -> int:
    print(f"{report.result}: {report.detail}")
    return 0 if report.result == "done" else 1
