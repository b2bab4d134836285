"""Puts another version of the agent in use and goes back by itself when that one does not come up.

Run by `robotether-agent switch`, as root, by the version that is in use, outside of the boot service. Whoever
asks may have come through the agent's own tunnel, so nothing here waits for them. A change that a power cut
ended is done again at the next boot, by `robotether-agent finish-switch` of the old version.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from robotether_agent import systemd
from robotether_agent.files import only_one, read_text
from robotether_agent.pending_upgrade import SILENT, PendingUpgrade
from robotether_agent.problems import Problem, UpgradeFailed
from robotether_agent.status import CONNECTED, Status, has_problem, is_alive, read_status
from robotether_agent.versions import Layout, Report

# A version that crashes and is started again shows a good state for a moment, too.
STABLE_S = 2.0
POLL_S = 0.2
# systemd's words for a service that nobody stopped.
RUNS = frozenset({"active", "activating", "reloading", "deactivating"})
# What stands in the place of an agent's state: a service that somebody stopped.
STOPPED = "stopped"
# States that an agent can stay in; the others pass.
LASTING = frozenset({CONNECTED, "pending", "waiting"})
# How much each state is worth: a switch must not end in a worse one.
NOT_WORSE = {
    CONNECTED: frozenset({CONNECTED}),
    "pending": frozenset({CONNECTED, "pending"}),
}


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

    def to(self, target: Path) -> Report:
        """Use `target`, or the old version again; return how it ended, which is written down as well."""
        was = self._layout.in_use()
        self._layout.check(target)
        report = self._reporter(was, target)
        with only_one(self._layout.lock, "switch"):
            if target == was:
                return report("done", f"{target.name} is in use already")
            return self._change(was, target, self._state(), report)

    def finish(self, was: Path, target: Path, state: str) -> Report:
        """Do again, after a boot, what began when the agent was in `state` and has no verdict yet."""
        with only_one(self._layout.lock, "switch"):
            return self._change(was, target, state, self._reporter(was, target))

    def _reporter(self, was: Path, target: Path) -> Callable[[str, str], Report]:
        began = time.time()

        def report(result: str, detail: str) -> Report:
            took_s = round(time.time() - began, 1)
            made = Report(result, was.name, target.name, detail, began, took_s)
            self._layout.write(made)
            return made

        return report

    def _change(
        self, was: Path, target: Path, before: str, report: Callable[[str, str], Report]
    ) -> Report:
        if before != STOPPED:
            self._pending.note(was, target, before, self._wait_s)
        report("running", f"switching from {was.name} to {target.name}")
        try:
            self._use(target, before)
        except Problem as problem:
            made = report("rolled_back", self._go_back(was, before, problem))
        else:
            made = report("done", f"{target.name} is in use")
        self._pending.clear()
        self._layout.keep_only(was, target)
        return made

    def _go_back(self, was: Path, before: str, why: Problem) -> str:
        text = f"{why.message}; {was.name} is in use again"
        try:
            self._use(was, before)
        except Problem as problem:
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

    def _wait(self, version: Path, wanted: frozenset[str], old_pid: float) -> None:
        """Wait until an agent of another process stands in one of the `wanted` states."""
        now = time.monotonic()
        deadline, good_since, good_pid = now + self._wait_s, now, 0.0
        while now < deadline:
            status = self._alive()
            good = status is not None and status.state in wanted and status.pid != old_pid
            pid = status.pid if status is not None and good else 0.0
            if pid != good_pid:
                good_since, good_pid = now, pid
            elif pid and now - good_since >= self._stable_s:
                return
            time.sleep(POLL_S)
            now = time.monotonic()
        raise UpgradeFailed(self._why_not(version, wanted))

    def _why_not(self, version: Path, wanted: frozenset[str]) -> str:
        status = self._alive()
        is_now = "it does not run" if status is None else f"it is {status.state}"
        problem = f" ({status.problem})" if status is not None and has_problem(status) else ""
        states = " or ".join(sorted(wanted))
        return f"{version.name} was not {states} within {self._wait_s:g} s: {is_now}{problem}"

    def _alive(self) -> Status | None:
        """Return the status of an agent that runs, None of one that was killed."""
        status = read_status(self._run_dir)
        if status is None or not is_alive(status, time.time()):
            return None
        return status if _runs(int(status.pid)) else None


def _runs(pid: int) -> bool:
    """Tell whether the process `pid` runs; one that ended and was not waited for yet does not."""
    text = read_text(Path(f"/proc/{pid}/stat"))
    return text is not None and text.rpartition(")")[2].split()[0] != "Z"
