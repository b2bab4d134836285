"""A unit that does a change of version again at the next boot, should the power go before its verdict.

Written by robotether_agent.upgrade before it changes anything, and removed when the verdict is there. What it
starts is the old version, since the new one may be what does not start.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from robotether_agent.files import write_atomic
from robotether_agent.problems import StateUnusable
from robotether_agent.status import MEANINGS

NAME = "robotether-agent-unfinished-switch.service"
# What stands in the place of the state of an agent that says nothing, or nothing known.
SILENT = "silent"
# The agent's own word becomes a word of a command that root runs.
STATES = frozenset({*MEANINGS, SILENT})
BOOT = "multi-user.target.wants"
ADVICE = "run this with sudo, and see that the disk is neither full nor read-only"
UNIT = """\
# There only while a change of version lasts; `robotether-agent switch` removes it.
[Unit]
Description=Robotether agent: finish a change of version that was cut short
# The verdict is whether the robot connects.
Wants=network-online.target
After=network-online.target robotether-agent.service

[Service]
# Not oneshot: the boot must not wait for a server that is down.
Type=exec
ExecStart={was}/bin/robotether-agent finish-switch --wait {wait_s:g} {was} {target} {state}
"""


@dataclass(frozen=True)
class PendingUpgrade:
    """The unit in `units`, the folder that systemd reads at boot."""

    units: Path

    def note(self, was: Path, target: Path, state: str, wait_s: float) -> None:
        """Let the next boot change from `was` to `target`, which must end in a state as good as `state`."""
        state = state if state in STATES else SILENT
        text = UNIT.format(was=was, target=target, state=state, wait_s=wait_s)
        write_atomic(self.units / NAME, text, 0o644)
        link = self.units / BOOT / NAME
        try:
            link.parent.mkdir(exist_ok=True)
            link.unlink(missing_ok=True)
            link.symlink_to(Path("..") / NAME)
        except OSError as error:
            raise StateUnusable(f"cannot make {link}: {error.strerror}", advice=ADVICE) from error

    def clear(self) -> None:
        """Leave the next boot alone."""
        link, unit = self.units / BOOT / NAME, self.units / NAME
        try:
            link.unlink(missing_ok=True)
            unit.unlink(missing_ok=True)
        except OSError as error:
            why = f"cannot remove {link}, which the next boot would start: {error.strerror}"
            raise StateUnusable(why, advice=ADVICE) from error
