"""What became of a command on each robot, and the table that tells it."""

from collections.abc import Sequence
from dataclasses import dataclass

from robotether_server.cli.fleet.output import Captured


@dataclass(frozen=True)
class Outcome:
    """One robot's. `status` None: the command did not come to its end, and `problem` says why."""

    robot: str
    status: int | None
    seconds: float
    problem: str | None = None
    out: Captured | None = None
    err: Captured | None = None

    @property
    def ok(self) -> bool:
        """Whether the command succeeded."""
        return self.status == 0

    @property
    def result(self) -> str:
        """What the table says."""
        if self.status is None:
            return self.problem or "unknown"
        return "ok" if self.ok else f"exit status {self.status}"


def as_dict(outcome: Outcome) -> dict[str, object]:
    """Return what --json prints of it."""
    out, err = outcome.out or Captured(), outcome.err or Captured()
    return {
        "robot": outcome.robot,
        "ok": outcome.ok,
        "status": outcome.status,
        "problem": outcome.problem,
        "seconds": round(outcome.seconds, 3),
        "stdout": out.text,
        "stderr": err.text,
        "cut": out.cut or err.cut,
    }


def as_rows(outcomes: Sequence[Outcome]) -> list[tuple[str, str, str]]:
    """Return the table's rows: what failed stands below, next to the prompt."""
    ordered = sorted(outcomes, key=lambda outcome: (not outcome.ok, outcome.robot))
    return [(one.robot, f"{one.seconds:.1f}", one.result) for one in ordered]


def verdict(outcomes: Sequence[Outcome]) -> str:
    """Return the last line: how many succeeded."""
    good = sum(outcome.ok for outcome in outcomes)
    return f"{good} of {len(outcomes)} robots: ok"
