"""The rows of fleets that start, idle and return, for the page of density. Pure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import pandas as pd
from report import Row, quantiles

from paper.step import Values

# A robot without an answer after this has failed, whatever comes later.
FAILED_AFTER_S = 60.0
# How many of a fleet are the real agent; all more are virtual robots.
AGENTS = 50
SERVER = ("nginx", "web", "relay", "sshd", "mysql")
# Columns of processor time and memory, and whose they are.
SERVER_PARTS = {
    "server": SERVER,
    "sshd": ("sshd",),
    "relay": ("relay",),
    "nginx, web, database": ("nginx", "web", "mysql"),
}
BESIDE = {"robots' side": ("robots",), "operators": ("operators",), "rest": ("rest",)}
MIB = 1024 * 1024
MS_PER_S = 1000.0


@dataclass(frozen=True)
class FleetOutcome:
    """A start or a return of a fleet, with the values of Fleet.run."""

    title: str
    count: int
    values: Values

    def seconds(self, name: str) -> pd.Series:
        """`drivable_s` or `online_s` of each robot that got so far."""
        return pd.Series(self.values[name], dtype=float).dropna()

    @property
    def in_time(self) -> int:
        """How many robots answered before they count as failed."""
        return int((self.seconds("drivable_s") <= FAILED_AFTER_S).sum())

    @property
    def late(self) -> int:
        return len(self.seconds("drivable_s")) - self.in_time

    @property
    def never(self) -> int:
        """How many robots never answered."""
        return self.count - len(self.seconds("drivable_s"))

    @property
    def waits(self) -> int:
        """How often operators had to try again."""
        return sum(self.values["waits"].values())

    def per_robot(
        self, values: str, names: Iterable[str] = SERVER, factor: float = 1.0
    ) -> float | None:
        """Some members of `cpu_s` or `memory_bytes` for a robot online; None without one."""
        robots = len(self.seconds("online_s"))
        used = sum(self.values[values].get(name, 0) for name in names)
        return factor * used / robots if robots else None

    def idle_ms(self, names: Iterable[str] = SERVER) -> float | None:
        """Processor time in ms that a robot costs in each second in which nobody uses it; None: not measured."""
        lasted = self.values.get("idle_s", 0) * len(self.seconds("online_s"))
        if not lasted:
            return None
        used = sum(self.values["idle_cpu_s"].get(name, 0.0) for name in names)
        return float(MS_PER_S * used / lasted)


def start_rows(runs: Iterable[FleetOutcome]) -> list[Row]:
    return [
        {
            "robots": run.title,
            "drivable in time": f"{run.in_time} of {run.count}",
            "later": run.late,
            "never": run.never,
            **quantiles(run.seconds("drivable_s"), 0.5, 0.99, 1),
            "online p50, s": run.seconds("online_s").quantile(0.5),
            "tried again": run.waits,
        }
        for run in runs
    ]


def cost_rows(runs: Iterable[FleetOutcome]) -> list[Row]:
    """What a robot costs: processor time of a start, memory, and processor time while nobody uses it."""
    rows = []
    for run in runs:
        columns: dict[str, object] = {
            "robots": run.title,
            "cores busy": sum(run.values["cpu_s"].values()) / run.values["took_s"],
        }
        for name, members in {**SERVER_PARTS, **BESIDE}.items():
            columns[f"start, ms: {name}"] = run.per_robot("cpu_s", members, MS_PER_S)
        for name, members in SERVER_PARTS.items():
            columns[f"memory, MiB: {name}"] = run.per_robot("memory_bytes", members, 1 / MIB)
        for name, members in {**SERVER_PARTS, "robots' side": ("robots",)}.items():
            columns[f"idle, ms a s: {name}"] = run.idle_ms(members)
        rows.append(columns)
    return rows


def return_rows(runs: Iterable[FleetOutcome]) -> list[Row]:
    return [
        {
            "restarted": run.title,
            "robots": run.count,
            "back in time": f"{run.in_time} of {run.count}",
            "later": run.late,
            "never": run.never,
            "server answers, s": run.values["server_s"],
            **quantiles(run.seconds("drivable_s"), 0.5, 0.99, 1),
            "tried again": run.waits,
        }
        for run in runs
    ]
