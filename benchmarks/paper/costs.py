"""Processor time and memory of the server's containers, of robots, of operators, and of the rest of this machine.

The kernel's control groups are read, of both kinds; the engine's own statistics are missing on some machines. Memory is
what the kernel cannot give back without the programs: their own pages and what the kernel itself keeps for them.
"""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from openssh_server import words_of_all

if TYPE_CHECKING:
    from docker.models.containers import Container

GROUPS = Path("/sys/fs/cgroup")
PROC = Path("/proc")
TICKS_PER_S = os.sysconf("SC_CLK_TCK")
# Of /proc/PID/stat behind the name: the parent; utime, stime, cutime and cstime.
PARENT, CPU_FIELDS = 1, slice(11, 15)
# Of /proc/stat's first line: idle and iowait are time in which nothing ran.
IDLE_FIELDS = (3, 4)
# Guests' time stands in the first two fields already.
MACHINE_FIELDS = 8


@dataclass(frozen=True)
class Use:
    cpu_s: float
    memory_bytes: int
    processes: int


def use_of(container: Container) -> Use:
    """What a running container has used since it started, by its control groups, of the first kind or the second."""
    container.reload()
    # The path by controller; "" is that of the unified hierarchy.
    paths: dict[str, str] = {}
    for line in (PROC / str(container.attrs["State"]["Pid"]) / "cgroup").read_text().splitlines():
        _, controllers, path = line.split(":", 2)
        paths.update(dict.fromkeys(controllers.split(","), path.lstrip("/")))
    if "memory" not in paths:
        folder = GROUPS / paths[""]
        memory = _table(folder / "memory.stat")
        return Use(
            cpu_s=_table(folder / "cpu.stat")["usage_usec"] / 1e6,
            memory_bytes=memory["anon"] + memory.get("kernel", 0),
            processes=int((folder / "pids.current").read_text()),
        )
    folders = {name: GROUPS / name / path for name, path in paths.items()}
    kernel = folders["memory"] / "memory.kmem.usage_in_bytes"
    return Use(
        cpu_s=int((folders["cpuacct"] / "cpuacct.usage").read_text()) / 1e9,
        memory_bytes=_table(folders["memory"] / "memory.stat")["total_rss"]
        + (int(kernel.read_text()) if kernel.exists() else 0),
        processes=int((folders["pids"] / "pids.current").read_text()),
    )


def trees_cpu_s(roots: Iterable[int]) -> list[float]:
    """Processor time of each process with all that it started, also of those that have ended and were waited for."""
    table = {
        pid: (int(words[PARENT]), sum(map(int, words[CPU_FIELDS])))
        for pid, words in words_of_all(PROC)
    }
    children: dict[int, list[int]] = {}
    for pid, (parent, _) in table.items():
        children.setdefault(parent, []).append(pid)

    def ticks(pid: int) -> int:
        return table.get(pid, (0, 0))[1] + sum(map(ticks, children.get(pid, ())))

    return [ticks(root) / TICKS_PER_S for root in roots]


def machine_cpu_s() -> float:
    fields = [int(word) for word in (PROC / "stat").read_text().split("\n", 1)[0].split()[1:]]
    busy = (ticks for at, ticks in enumerate(fields[:MACHINE_FIELDS]) if at not in IDLE_FIELDS)
    return sum(busy) / TICKS_PER_S


@dataclass(frozen=True)
class Reading:
    at_s: float
    services: Mapping[str, Use]
    robots_cpu_s: float
    operators_cpu_s: float
    machine_cpu_s: float

    @classmethod
    def now(cls, containers: Mapping[str, Container], workers: Sequence[int]) -> Reading:
        """Read; `workers` are the processes that the robots are made of, this one plays the operators."""
        own = resource.getrusage(resource.RUSAGE_SELF)
        return cls(
            at_s=time.monotonic(),
            services={name: use_of(container) for name, container in containers.items()},
            robots_cpu_s=sum(trees_cpu_s(workers)),
            operators_cpu_s=own.ru_utime + own.ru_stime,
            machine_cpu_s=machine_cpu_s(),
        )


def cpu_between(first: Reading, last: Reading) -> dict[str, float]:
    """Seconds of processor time by who used them; `rest` is what this machine did beside, the engine's for instance.

    A container that was restarted meanwhile counts from its new start on.
    """
    used = {
        name: use.cpu_s - first.services[name].cpu_s * (use.cpu_s >= first.services[name].cpu_s)
        for name, use in last.services.items()
    }
    used["robots"] = last.robots_cpu_s - first.robots_cpu_s
    used["operators"] = last.operators_cpu_s - first.operators_cpu_s
    return {**used, "rest": last.machine_cpu_s - first.machine_cpu_s - sum(used.values())}


def memory_between(first: Reading, last: Reading) -> dict[str, int]:
    return {
        name: use.memory_bytes - first.services[name].memory_bytes
        for name, use in last.services.items()
    }


def _table(path: Path) -> dict[str, int]:
    return {name: int(value) for name, value in map(str.split, path.read_text().splitlines())}
