"""The rows of fleets that start, idle and return, for the page of density. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import pandas as pd
from report import Row, plain, quantiles

from paper.step import Values

# A robot without a message after this has failed, whatever comes later.
FAILED_AFTER_S = 60.0
# How many of a fleet are the real agent; all more are virtual robots.
AGENTS = 50
SERVER = ("nginx", "web", "relay", "sshd", "mysql")
# Columns of processor time and memory, and whose they are.
SERVER_PARTS = {
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
        """`message_s` or `online_s` of each robot that got so far."""
        return pd.Series(self.values[name], dtype=float).dropna()

    @property
    def in_time(self) -> int:
        """How many robots got their message before they count as failed."""
        return int((self.seconds("message_s") <= FAILED_AFTER_S).sum())

    @property
    def late(self) -> int:
        return len(self.seconds("message_s")) - self.in_time

    @property
    def never(self) -> int:
        """How many robots got no message at all."""
        return self.count - len(self.seconds("message_s"))

    @property
    def doubled(self) -> int:
        """How many robots got more than one message, as an operator took one for lost."""
        return int(self.values["received"]) - len(self.seconds("message_s"))

    @property
    def waits(self) -> Counter[str]:
        """Why operators had to try again, by the server's words."""
        return Counter(self.values["waits"])

    def per_robot(self, values: str, names: Iterable[str] = SERVER) -> float | None:
        """Some members of `cpu_s` or `memory_bytes` for a robot online; None without one."""
        robots = len(self.seconds("online_s"))
        used = sum(self.values[values].get(name, 0) for name in names)
        return used / robots if robots else None

    def idle_ms(self, names: Iterable[str] = SERVER) -> float | None:
        """Processor time in ms that a robot costs in each second in which nobody uses it; None: not measured."""
        lasted = self.values.get("idle_s", 0) * len(self.seconds("online_s"))
        if not lasted:
            return None
        used = sum(self.values["idle_cpu_s"].get(name, 0.0) for name in names)
        return float(MS_PER_S * used / lasted)

    @property
    def last_words(self) -> str:
        """What an agent said last where some robot never got its message; mostly why."""
        return next((lines.splitlines()[-1] for lines in self.values["failures"] if lines), "")


def start_rows(runs: Iterable[FleetOutcome]) -> list[Row]:
    return [
        {
            "robots": run.title,
            "message in time": f"{run.in_time} of {run.count}",
            "later": run.late,
            "never": run.never,
            **quantiles(run.seconds("message_s"), 0.5, 0.99, 1),
            "online p50, s": run.seconds("online_s").quantile(0.5),
            "tried again": run.waits.total(),
            "wrong robot": run.values["wrong"],
            "doubled": run.doubled,
        }
        for run in runs
    ]


def cost_rows(runs: Iterable[FleetOutcome]) -> list[Row]:
    return [_cost_row(run) for run in runs]


def _cost_row(item: FleetOutcome) -> Row:
    used = sum(item.values["cpu_s"].values())
    columns: dict[str, object] = {"robots": item.title, "cores busy": used / item.values["took_s"]}
    for name, members in {"server": SERVER, **SERVER_PARTS, **BESIDE}.items():
        columns[f"start, ms: {name}"] = _times(item.per_robot("cpu_s", members), MS_PER_S)
    for name, members in {"server": SERVER, **SERVER_PARTS}.items():
        columns[f"memory, MiB: {name}"] = _times(item.per_robot("memory_bytes", members), 1 / MIB)
    for name, members in {"server": SERVER, **SERVER_PARTS, "robots' side": ("robots",)}.items():
        columns[f"idle, ms a s: {name}"] = item.idle_ms(members)
    return {**columns, "limits met": plain("; ".join(item.values["limits"])) or "none"}


def idle_rows(run: FleetOutcome) -> list[Row]:
    return [
        {
            "part": part,
            "processor, ms a s": run.idle_ms(members),
            "memory, MiB": _times(run.per_robot("memory_bytes", members), 1 / MIB),
        }
        for part, members in {"server": SERVER, **SERVER_PARTS}.items()
    ]


def return_rows(runs: Iterable[FleetOutcome]) -> list[Row]:
    return [
        {
            "restarted": run.title,
            "robots": run.count,
            "back in time": f"{run.in_time} of {run.count}",
            "later": run.late,
            "never": run.never,
            "server answers, s": run.values["server_s"],
            **quantiles(run.seconds("message_s"), 0.5, 0.99, 1),
            "tried again": run.waits.total(),
        }
        for run in runs
    ]


def shortfalls(what: str, runs: Iterable[FleetOutcome]) -> Iterable[str]:
    """What did not come in time and which limits were met; `what` is "the start" or "the return"."""
    for run in runs:
        if missing := run.count - run.in_time:
            heard = ", ".join(f"{why} ({times})" for why, times in run.waits.most_common(3))
            said = f"; an agent said last: {run.last_words:.200}" if run.last_words else ""
            yield (
                f"{what}, {run.title}: {missing} of {run.count} robots had no message within "
                f"{FAILED_AFTER_S:g} s, {run.late} of them later; operators heard: {heard or 'nothing'}{said}"
            )
        yield from (f"{what}, {run.title}: {words}" for words in run.values["limits"])


def _times(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor
