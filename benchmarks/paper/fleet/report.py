"""The rows of fleets that start, idle and return, for the page of density. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import pandas as pd
from report import Row, plain, quantiles

from paper.step import Outcome, Values

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
class Group:
    """All runs of one kind and size, each the values of Fleet.run."""

    title: str
    count: int
    outcomes: Sequence[Outcome]
    planned: int = 1

    @cached_property
    def runs(self) -> list[Values]:
        """What was measured in the runs that did not fail as a whole."""
        return [outcome.values for outcome in self.outcomes if outcome.values is not None]

    def seconds(self, name: str) -> pd.Series:
        """`message_s` or `online_s` of each robot that got so far."""
        return pd.Series(
            [outcome for run in self.runs for outcome in run[name]], dtype=float
        ).dropna()

    def total(self, name: str) -> int:
        return sum(run[name] for run in self.runs)

    @property
    def wanted(self) -> int:
        """How many messages robots should have got in all runs, those that failed as a whole included."""
        return self.count * len(self.outcomes)

    @property
    def in_time(self) -> int:
        """How many robots got their message before they count as failed."""
        return int((self.seconds("message_s") <= FAILED_AFTER_S).sum())

    @property
    def late(self) -> int:
        return len(self.seconds("message_s")) - self.in_time

    @property
    def never(self) -> int:
        """How many robots got none at all, also of runs that failed."""
        return self.wanted - len(self.seconds("message_s"))

    @property
    def success(self) -> float:
        """The share in percent of robots that got their message in time."""
        return 100.0 * self.in_time / self.wanted if self.wanted else 0.0

    @property
    def doubled(self) -> int:
        """How many robots got more than one message, as an operator took one for lost."""
        return self.total("received") - len(self.seconds("message_s"))

    @property
    def waits(self) -> Counter[str]:
        """Why operators had to try again, by the server's words."""
        return sum((Counter(run["waits"]) for run in self.runs), Counter())

    @property
    def limits(self) -> list[str]:
        return sorted({words for run in self.runs for words in run["limits"]})

    def per_robot(self, values: str, names: Iterable[str] = SERVER) -> float | None:
        """The mean of some members of `cpu_s` or `memory_bytes` for a robot online; None without one."""
        robots = len(self.seconds("online_s"))
        used = sum(run[values].get(name, 0) for run in self.runs for name in list(names))
        return used / robots if robots else None

    def idle_ms(self, names: Iterable[str] = SERVER) -> float | None:
        """Processor time in ms that a robot costs in each second in which nobody uses it; None: not measured."""
        measured = [run for run in self.runs if "idle_s" in run]
        used = sum(run["idle_cpu_s"].get(name, 0.0) for run in measured for name in list(names))
        lasted = sum(run["idle_s"] * pd.Series(run["online_s"]).count() for run in measured)
        return MS_PER_S * used / lasted if lasted else None

    @property
    def last_words(self) -> str:
        """What an agent said last in a run in which some robot never got its message; mostly why."""
        said = (lines for run in self.runs for lines in run["failures"])
        return next((lines.splitlines()[-1] for lines in said if lines), "")


def start_rows(groups: Iterable[Group]) -> list[Row]:
    return [
        {
            "robots": group.title,
            "runs": f"{len(group.outcomes)} of {group.planned}",
            "message in time": f"{group.in_time} of {group.wanted}",
            "later": group.late,
            "never": group.never,
            **quantiles(group.seconds("message_s"), 0.5, 0.99, 1),
            "online p50, s": group.seconds("online_s").quantile(0.5),
            "tried again": group.waits.total(),
            "wrong robot": group.total("wrong"),
            "doubled": group.doubled,
        }
        for group in groups
    ]


def cost_rows(groups: Iterable[Group]) -> list[Row]:
    return [_cost_row(group) for group in groups]


def _cost_row(item: Group) -> Row:
    took = sum(run["took_s"] for run in item.runs)
    used = sum(sum(run["cpu_s"].values()) for run in item.runs)
    columns: dict[str, object] = {"robots": item.title, "cores busy": used / took if took else None}
    for name, members in {"server": SERVER, **SERVER_PARTS, **BESIDE}.items():
        columns[f"start, ms: {name}"] = _times(item.per_robot("cpu_s", members), MS_PER_S)
    for name, members in {"server": SERVER, **SERVER_PARTS}.items():
        columns[f"memory, MiB: {name}"] = _times(item.per_robot("memory_bytes", members), 1 / MIB)
    for name, members in {"server": SERVER, **SERVER_PARTS, "robots' side": ("robots",)}.items():
        columns[f"idle, ms a s: {name}"] = item.idle_ms(members)
    return {**columns, "limits met": plain("; ".join(item.limits)) or "none"}


def return_rows(groups: Iterable[Group]) -> list[Row]:
    return [
        {
            "restarted": group.title,
            "robots": group.count,
            "back in time": f"{group.in_time} of {group.wanted}",
            "later": group.late,
            "never": group.never,
            "server answers, s": pd.Series(
                [run["server_s"] for run in group.runs], dtype=float
            ).max(),
            **quantiles(group.seconds("message_s"), 0.5, 0.99, 1),
            "tried again": group.waits.total(),
        }
        for group in groups
    ]


def shortfalls(what: str, groups: Iterable[Group]) -> Iterable[str]:
    """What did not come in time and which limits were met; `what` is "the start" or "the return"."""
    for group in groups:
        if missing := group.wanted - group.in_time:
            heard = ", ".join(f"{why} ({times})" for why, times in group.waits.most_common(3))
            said = f"; an agent said last: {group.last_words:.200}" if group.last_words else ""
            yield (
                f"{what}, {group.title}: {missing} of {group.wanted} robots had no message within "
                f"{FAILED_AFTER_S:g} s, {group.late} of them later; operators heard: {heard or 'nothing'}{said}"
            )
        yield from (f"{what}, {group.title}: {words}" for words in group.limits)


def _times(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor
