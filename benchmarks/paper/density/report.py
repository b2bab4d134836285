"""The rows of fleets that start, idle, are driven, return and last, and the aims for density's figures. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd
from report import Row, plain, quantiles

from paper.fleet.fleet import AGENTS, FAILED_AFTER_S
from paper.histogram import Histogram
from paper.step import Comparison, Report, Results, Values, against_aim, succeeded

RATE_HZ = 50
# Of issue 17, on two cores for everything, and of issue 35; those of a start, of idle robots and memory are a robot's.
AIM_RETURN_P50_S = 30.0
AIM_IDLE_MS, AIM_MEMORY_MIB, AIM_START_MS = 0.2, 2.0, 60.0
AIM_DRIVE_P99_MS = 50.0
AIM_SOAK_PERCENT = 3.0
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
KINDS = {"agent": "agents", "virtual": "virtual robots"}
Drives = Sequence[Mapping[str, Any]]


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
            **_arrivals(run),
            "online p50, s": run.seconds("online_s").quantile(0.5),
        }
        for run in runs
    ]


def return_rows(runs: Iterable[FleetOutcome]) -> list[Row]:
    return [
        {"robots": run.count, **_arrivals(run), "server answers, s": run.values["server_s"]}
        for run in runs
    ]


def _arrivals(run: FleetOutcome) -> Row:
    return {
        "drivable in time": f"{run.in_time} of {run.count}",
        "later": run.late,
        "never": run.never,
        **quantiles(run.seconds("drivable_s"), 0.5, 0.99, 1),
        "tried again": sum(run.values["waits"].values()),
    }


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


def report(results: Results) -> Report:
    """The part's report, of the steps that have run."""
    values = succeeded(results)
    fleets = [value for name, value in values.items() if name.startswith("fleet-")]
    soaks = [value for name, value in values.items() if name.startswith("soak-")]
    starts = [
        FleetOutcome(
            f"{fleet['count']}, {fleet['agents']} of them agents", fleet["count"], fleet["start"]
        )
        for fleet in fleets
    ]
    returns = [FleetOutcome("", fleet["count"], fleet["return"]) for fleet in fleets]
    whole = [start for start in starts if not start.never]
    return Report(
        values={
            "starts": start_rows(starts),
            "costs": cost_rows(starts),
            "driven": [row for fleet in fleets for row in _driven_rows(fleet)],
            "returns": return_rows(returns),
            "soaks": [(soak, _soak_rows(soak)) for soak in soaks],
            "agents": AGENTS,
            "rate_hz": RATE_HZ,
            "failed_after_s": FAILED_AFTER_S,
            "carries": _carries(whole[-1]) if whole else None,
        },
        comparisons=[*_aims(fleets, starts, returns), *_aims_of_soaks(soaks)],
    )


def _carries(run: FleetOutcome) -> Mapping[str, float]:
    """How many idle robots a core and a GiB carry."""
    memory = run.per_robot("memory_bytes", factor=1 / MIB) or 0
    return {
        "count": run.count,
        "a_core": MS_PER_S / (run.idle_ms() or float("nan")),
        "a_gib": 1024 / memory if memory > 0 else float("nan"),
    }


def merged(drives: Drives, name: str) -> Histogram:
    return Histogram.merged(drive[name] for drive in drives)


def _counts(drives: Drives) -> Row:
    return {
        "commands": sum(drive["sent"] for drive in drives),
        "lost": lost(drives, "lost"),
        "not sent": lost(drives, "unsent"),
        "refusals told": sum(sum(drive["refused"].values()) for drive in drives),
        "connections that ended": sum(sum(drive["endings"].values()) for drive in drives),
    }


def lost(drives: Drives, *names: str) -> int:
    return sum(drive[name] for drive in drives for name in names or ("lost", "unsent"))


def _driven_rows(fleet: Values) -> Iterable[Row]:
    drive = fleet["drive"]
    if "failure" in drive:
        yield {"robots": fleet["count"], "driven": plain(drive["failure"][:200])}
        return
    used, took_s = drive["fleet_cpu_s"], drive["took_s"]
    for kind, words in KINDS.items():
        if some := [item for item in drive["drives"] if item["kind"] == kind]:
            yield {
                "robots": fleet["count"],
                "driven": f"{len(some)} {words}",
                **_counts(some),
                **quantiles(merged(some, "round_trips").times_ms, 0.5, 0.99, 1, unit="ms"),
                "sent late, p99, ms": merged(some, "late").quantile_ms(0.99),
                "server, % of a core": 100 * sum(used[name] for name in SERVER) / took_s,
                "cores busy": sum(used.values()) / took_s,
                # The drivers are a process of their own.
                "others": (used["rest"] - drive["cpu_s"]) / took_s,
            }


def _soak_rows(soak: Values) -> Iterable[Row]:
    for number, item in enumerate(soak["rounds"], 1):
        drives = item["drive"].get("drives", [])
        back = pd.Series(item["drivable_s"], dtype=float).dropna()
        yield {
            "part": number,
            **(_counts(drives) if drives else {"commands": plain(item["drive"]["failure"][:100])}),
            "p99, ms": merged(drives, "round_trips").quantile_ms(0.99),
            "memory, MiB": sum(item["memory_bytes"].values()) / MIB,
            "returned": f"{len(back)} of {soak['count']}",
            **quantiles(back, 0.5, 1),
        }


def memory_spread_percent(soak: Values) -> float:
    """How far memory moves from that of the second part, or of the only one: the first one fills caches."""
    totals = pd.Series([sum(item["memory_bytes"].values()) for item in soak["rounds"]])
    totals = totals.iloc[1:] if len(totals) > 1 else totals
    return float(100 * (totals / totals.iloc[0] - 1).abs().max())


def _aims(
    fleets: Sequence[Values], starts: Sequence[FleetOutcome], returns: Sequence[FleetOutcome]
) -> Iterable[Comparison]:
    """Beside the largest fleet that was measured."""
    if not fleets:
        return
    started, back = starts[-1], returns[-1]
    drives = fleets[-1]["drive"].get("drives", [])
    start_ms = started.per_robot("cpu_s", factor=MS_PER_S)
    memory_mib = started.per_robot("memory_bytes", factor=1 / MIB)
    late = float(back.count - back.in_time)
    p50 = back.seconds("drivable_s").quantile(0.5)
    p99 = merged(drives, "round_trips").quantile_ms(0.99)
    for what, aim, ours, unit in (
        ("late or never back after all containers restart", 0.0, late, "robots"),
        ("back after all containers restart, p50", AIM_RETURN_P50_S, p50, "s"),
        ("idle, server's processor a robot and s", AIM_IDLE_MS, started.idle_ms(), "ms"),
        ("server's memory a robot", AIM_MEMORY_MIB, memory_mib, "MiB"),
        ("a start, server's processor a robot", AIM_START_MS, start_ms, "ms"),
        (f"driven at {RATE_HZ} Hz: p99 there and back", AIM_DRIVE_P99_MS, p99, "ms"),
        (f"driven at {RATE_HZ} Hz: lost", 0.0, lost(drives) if drives else None, "commands"),
    ):
        yield against_aim(f"{started.count} robots, {what}", aim, ours, unit)


def _aims_of_soaks(soaks: Sequence[Values]) -> Iterable[Comparison]:
    for soak in soaks:
        what = f"{soak['count']} robots for {soak['seconds'] / 60:.3g} minutes"
        if soak["rounds"]:
            spread = memory_spread_percent(soak)
            yield against_aim(f"{what}: memory moves by", AIM_SOAK_PERCENT, spread, "%")
        gone = sum(lost(item["drive"].get("drives", [])) for item in soak["rounds"])
        yield against_aim(f"{what}: commands lost", 0.0, gone, "commands")
