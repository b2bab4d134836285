"""Switches to another version of the agent, and rolls back if that one does not start.

Run by `robotether-agent switch`, as root, by the version that is in use, outside of the boot service. Whoever
asks may have come through the agent's own tunnel, so nothing here waits for them. A change that a power cut
ended is done again at the next boot, by `robotether-agent finish-switch` of the old version.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from robotether_agent import systemd
from robotether_agent.files import only_one, read_text, write_atomic
from robotether_agent.problems import AgentError, StateUnusableError, UpgradeFailedError
from robotether_agent.status import CONNECTED, MEANINGS, Status, has_problem, is_alive, read_status

UNIT = Path("/etc/systemd/system/robotether-agent.service")
COMMAND = "bin/robotether-agent"
NEW_UNIT = "share/robotether-agent/robotether-agent.service"
PENDING_NAME = "robotether-agent-unfinished-switch.service"
# In place of the state of an agent that says nothing, or nothing known.
SILENT = "silent"
# The agent's own word becomes a word of a command that root runs.
STATES = frozenset({*MEANINGS, SILENT})
BOOT = "multi-user.target.wants"
PENDING_ADVICE = "run this with sudo, and see that the disk is neither full nor read-only"
PENDING_UNIT = """\
# There only during a change of version; `robotether-agent switch` removes it.
[Unit]
Description=Robotether agent: finish an interrupted change of version
# The verdict is whether the robot connects.
Wants=network-online.target
After=network-online.target robotether-agent.service

[Service]
# Not oneshot: the boot must not wait for a server that is down.
Type=exec
ExecStart={was}/bin/robotether-agent finish-switch --wait {wait_s:g} {was} {target} {state}
"""
# Time for which a new version must work; one that crashes and restarts also looks good briefly.
STABLE_S = 2.0
POLL_S = 0.2
# systemd's words for a service that nobody stopped.
RUNS = frozenset({"active", "activating", "reloading", "deactivating"})
# In place of an agent's state: a service that somebody stopped.
STOPPED = "stopped"
# States that an agent can stay in; the others pass.
LASTING = frozenset({CONNECTED, "pending", "waiting"})
# How much each state is worth: a switch must not end in a worse one.
NOT_WORSE = {
    CONNECTED: frozenset({CONNECTED}),
    "pending": frozenset({CONNECTED, "pending"}),
}


@dataclass(frozen=True)
class UpgradeReport:
    """How a change went: `result` is running, done or rolled_back; `at` seconds since 1970."""

    result: str
    was: str
    wanted: str
    detail: str
    at: float
    took_s: float = 0.0


@dataclass(frozen=True)
class Layout:
    """The folder of all versions, and the unit file that systemd reads."""

    base: Path
    unit: Path = UNIT

    @property
    def lock(self) -> Path:
        """Held while a change is under way."""
        return self.base / ".switch.lock"

    def in_use(self) -> Path:
        """Return the version that `current` leads to."""
        try:
            return self.base / (self.base / "current").readlink()
        except OSError as error:
            raise UpgradeFailedError(
                f"cannot switch: {self.base}/current leads to no version: {error.strerror}",
                advice=f"name a folder in versions/ of an installed agent, such as {self.base}/versions/NAME",
            ) from error

    def check(self, version: Path) -> None:
        """Raise UpgradeFailedError unless `version` is one of this folder's, whole and startable."""
        command = version / COMMAND
        if version.parent != self.base / "versions" or not os.access(command, os.X_OK):
            raise UpgradeFailedError(
                f"cannot switch to {version}: there is no {command} that can be run",
                advice="name a folder in versions/ that holds an installed agent",
            )

    def use(self, version: Path) -> bool:
        """Let `current` lead to `version` and install its unit file; return whether that is another one."""
        link = self.base / ".current.new"
        try:
            link.unlink(missing_ok=True)
            link.symlink_to(Path("versions") / version.name)
            link.replace(self.base / "current")
        except OSError as error:
            raise StateUnusableError(
                f"cannot change {self.base}/current: {error.strerror}",
                advice="run this with sudo, and see that the disk is neither full nor read-only",
            ) from error
        unit = read_text(version / NEW_UNIT)
        if unit is None or unit == read_text(self.unit):
            return False
        write_atomic(self.unit, unit, 0o644)
        return True

    def keep_only(self, *versions: Path) -> None:
        """Remove all other versions; one that cannot be removed is left."""
        for path in (self.base / "versions").iterdir():
            if path not in versions:
                shutil.rmtree(path, ignore_errors=True)

    def write(self, report: UpgradeReport) -> None:
        """Write last-switch.json."""
        text = json.dumps(asdict(report), indent=1) + "\n"
        write_atomic(self.base / "last-switch.json", text, 0o644)


@dataclass(frozen=True)
class PendingUpgrade:
    """The unit in `units`, the folder that systemd reads at boot."""

    units: Path

    def note(self, was: Path, target: Path, state: str, wait_s: float) -> None:
        """Let the next boot change from `was` to `target`, which must end in a state as good as `state`."""
        state = state if state in STATES else SILENT
        text = PENDING_UNIT.format(was=was, target=target, state=state, wait_s=wait_s)
        write_atomic(self.units / PENDING_NAME, text, 0o644)
        link = self.units / BOOT / PENDING_NAME
        try:
            link.parent.mkdir(exist_ok=True)
            link.unlink(missing_ok=True)
            link.symlink_to(Path("..") / PENDING_NAME)
        except OSError as error:
            raise StateUnusableError(
                f"cannot make {link}: {error.strerror}", advice=PENDING_ADVICE
            ) from error

    def clear(self) -> None:
        """Leave the next boot alone."""
        link, unit = self.units / BOOT / PENDING_NAME, self.units / PENDING_NAME
        try:
            link.unlink(missing_ok=True)
            unit.unlink(missing_ok=True)
        except OSError as error:
            why = f"cannot remove {link}, which the next boot would start: {error.strerror}"
            raise StateUnusableError(why, advice=PENDING_ADVICE) from error


class Upgrade:
    """One change of the version in use."""

    def __init__(
        self, layout: Layout, run_dir: Path, wait_s: float, *, stable_s: float = STABLE_S
    ) -> None:
        self._layout = layout
        self._run_dir = run_dir
        self._wait_s = wait_s
        self._stable_s = stable_s
        self._pending = PendingUpgrade(layout.unit.parent)

    def to(self, target: Path) -> UpgradeReport:
        """Use `target`, or the old version again; return how it ended, which is written down as well."""
        was = self._layout.in_use()
        self._layout.check(target)
        report = self._reporter(was, target)
        with only_one(self._layout.lock, "switch"):
            if target == was:
                return report("done", f"{target.name} is in use already")
            return self._change(was, target, self._state(), report)

    def finish(self, was: Path, target: Path, state: str) -> UpgradeReport:
        """Do again, after a boot, what began when the agent was in `state` and has no verdict yet."""
        with only_one(self._layout.lock, "switch"):
            return self._change(was, target, state, self._reporter(was, target))

    def _reporter(self, was: Path, target: Path) -> Callable[[str, str], UpgradeReport]:
        # A clock that is set meanwhile, as after a boot, makes no change long.
        began, began_s = time.time(), time.monotonic()

        def report(result: str, detail: str) -> UpgradeReport:
            took_s = round(time.monotonic() - began_s, 1)
            outcome = UpgradeReport(result, was.name, target.name, detail, began, took_s)
            self._layout.write(outcome)
            return outcome

        return report

    def _change(
        self, was: Path, target: Path, before: str, report: Callable[[str, str], UpgradeReport]
    ) -> UpgradeReport:
        report("running", f"switching from {was.name} to {target.name}")
        if before != STOPPED:
            self._pending.note(was, target, before, self._wait_s)
        try:
            self._use(target, before)
        except AgentError as problem:
            result, detail = "rolled_back", self._go_back(was, before, problem)
        else:
            result, detail = "done", f"{target.name} is in use"
        try:
            outcome = report(result, detail)
        finally:
            # A full disk takes no report, and is no reason to do it all again at the next boot.
            self._pending.clear()
        self._layout.keep_only(was, target)
        return outcome

    def _go_back(self, was: Path, before: str, why: AgentError) -> str:
        text = f"{why.message}; {was.name} is in use again"
        try:
            self._use(was, before)
        except AgentError as problem:
            return f"{text}, but is not as before: {problem}"
        return f"{text}, as before"

    def _use(self, version: Path, before: str) -> None:
        """Put `version` in place and, unless somebody stopped the service, wait until it is up."""
        old = self._alive()
        if self._layout.use(version):
            systemd.reload_units()
        if before != STOPPED:
            systemd.restart()
            self._wait(version, NOT_WORSE.get(before, LASTING), old.pid if old else 0)

    def _state(self) -> str:
        """Return how the agent is, in its own word or STOPPED or SILENT."""
        status = self._alive()
        if status is not None:
            return status.state
        return SILENT if systemd.state() in RUNS else STOPPED

    def _wait(self, version: Path, goal_states: frozenset[str], old_pid: float) -> None:
        """Wait until an agent of another process is in one of the `goal_states`."""
        now = time.monotonic()
        deadline, good_since, good_pid = now + self._wait_s, now, 0.0
        while now < deadline:
            status = self._alive()
            good = status is not None and status.state in goal_states and status.pid != old_pid
            pid = status.pid if status is not None and good else 0.0
            if pid != good_pid:
                good_since, good_pid = now, pid
            elif pid and now - good_since >= self._stable_s:
                return
            time.sleep(POLL_S)
            now = time.monotonic()
        raise UpgradeFailedError(self._why_not(version, goal_states))

    def _why_not(self, version: Path, goal_states: frozenset[str]) -> str:
        status = self._alive()
        is_now = "it does not run" if status is None else f"it is {status.state}"
        problem = f" ({status.problem})" if status is not None and has_problem(status) else ""
        states = " or ".join(sorted(goal_states))
        return f"{version.name} was not {states} within {self._wait_s:g} s: {is_now}{problem}"

    def _alive(self) -> Status | None:
        """Return the status of an agent that runs, None of one that was killed."""
        status = read_status(self._run_dir)
        if status is None or not is_alive(status, time.time()):
            return None
        return status if _runs(int(status.pid)) else None


def _runs(pid: int) -> bool:
    """Return whether the process `pid` runs; one that ended and was not waited for yet does not."""
    text = read_text(Path(f"/proc/{pid}/stat"))
    return text is not None and text.rpartition(")")[2].split()[0] != "Z"
