"""Checks every step from the settings to the end-to-end path, for `robotether-agent doctor`.

It changes nothing on the robot, joins nothing, and logs in nowhere.

    checks    all in order, and those of the robot itself
    server    the server, as seen from here
    encoder   what encodes video
    tunnel    SSH, the boot service, and the agent's own status
"""

from __future__ import annotations

from dataclasses import dataclass

OK, FAIL, WARNING, SKIPPED = "ok", "FAIL", "warning", "skipped"


@dataclass(frozen=True)
class Finding:
    """One step's result; `advice` comes only with a FAIL or a warning."""

    step: str
    state: str
    detail: str
    advice: str = ""

    def __str__(self) -> str:
        line = f"{self.state:<8} {self.step:<12} {self.detail}"
        return f"{line}\n{'':<22}what to do: {self.advice}" if self.advice else line


def ok(step: str, detail: str) -> Finding:
    """Return that a step is well."""
    return Finding(step, OK, detail)


def fail(step: str, detail: str, advice: str) -> Finding:
    """Return what is wrong with a step, and what to do."""
    return Finding(step, FAIL, detail, advice)


def warning(step: str, detail: str, advice: str) -> Finding:
    """Return what works and should not stay so, and what to do."""
    return Finding(step, WARNING, detail, advice)


def skipped(step: str, why: str) -> Finding:
    """Return that a step could not be looked at, or need not be."""
    return Finding(step, SKIPPED, why)
