"""Breaks a site by a seed, one or two things at a time, and mends each again; at the end all, also when it is ended."""

from __future__ import annotations

import asyncio
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING

from commands import output_of_command, run_command

from paper.cells.history import History
from paper.cells.site import DATABASE_PORT, OF_DATABASE, OF_PEERS, SERVICES, Cell, Site, drop

if TYPE_CHECKING:
    from paper.cells.workload import RobotProcess

LASTS_S, BETWEEN_S = (3.0, 10.0), (3.0, 8.0)
# What is broken at once, at most; and how many cells at least are as they should be, but where all are concerned.
MOST_AT_ONCE = 2
# The database comes back from a loss of power.
DATABASE_WITHIN_S = 60.0
GUARDS_SHARE = 0.2
# Ahead or behind.
MOST_STEPPED_S = 60.0


@dataclass(frozen=True)
class Target:
    cell: str = ""
    source: str = ""


@dataclass
class Context:
    site: Site
    # By their sources.
    robots: Mapping[str, RobotProcess]
    rng: Random

    def cell(self, target: Target) -> Cell:
        return next(item for item in self.site.cells if item.name == target.cell)

    def full(self, target: Target) -> Path:
        return self.robots[target.source].disk / "full"


Do = Callable[[Context, Target], None]


@dataclass(frozen=True)
class Fault:
    """One kind; `mend` may be called twice, and for what was only half done."""

    do: Do
    mend: Do
    # What it is done to.
    of_cell: bool = True
    of_robots: bool = False
    weight: int = 2


def _kill(*services: str) -> Do:
    return lambda context, target: context.cell(target).each(services, "kill")


def _start(*services: str) -> Do:
    def mend(context: Context, target: Target) -> None:
        context.cell(target).each(services, "start")
        context.cell(target).wait_live()

    return mend


def _unpause(context: Context, target: Target) -> None:
    context.cell(target).each(SERVICES, "unpause")
    context.cell(target).wait_live()


def _step_clock(most_s: float) -> Do:
    return lambda context, target: context.cell(target).step_clock(
        context.rng.uniform(-most_s, most_s)
    )


def _order(order: str) -> Do:
    return lambda context, target: context.cell(target).order(order)


def _cut_robots(context: Context, target: Target, *, to_drop: bool) -> None:
    inside = context.robots[target.source].inside()
    drop(inside, context.cell(target).ssh_ports, to_drop=to_drop)


def _cut_database(context: Context, target: Target, *, to_drop: bool) -> None:
    ports = [DATABASE_PORT, int(str(context.site.cells[0].stack.settings["DB_PORT"]))]
    context.cell(target).drop_to(OF_DATABASE, ports, to_drop=to_drop)


def _cut_peers(context: Context, target: Target, *, to_drop: bool) -> None:
    cell = context.cell(target)
    others = [item for item in context.site.cells if item is not cell]
    cell.drop_to(OF_PEERS, [item.peer_port for item in others], to_drop=to_drop)
    for item in others:
        item.drop_to(OF_PEERS, [cell.peer_port], to_drop=to_drop)


def _cut(how: Callable[..., None]) -> tuple[Do, Do]:
    return partial(how, to_drop=True), partial(how, to_drop=False)


def _kill_database(context: Context, _: Target) -> None:
    context.site.cells[0].each(["mysql"], "kill")


def _start_database(context: Context, _: Target) -> None:
    first = context.site.cells[0]
    first.each(["mysql"], "start")
    first.stack.wait_healthy("mysql", DATABASE_WITHIN_S)
    context.site.wait_live()


def _fill(context: Context, target: Target) -> None:
    """Write until nothing more fits; zeros in small pieces, so that nothing is left."""
    with context.full(target).open("wb", buffering=0) as file, suppress(OSError):
        while True:
            file.write(bytes(4096))


FAULTS: Mapping[str, Fault] = {
    "cell_killed": Fault(_kill(*SERVICES), _start(*SERVICES), weight=3),
    "relay_killed": Fault(_kill("relay"), _start("relay"), weight=3),
    "sshd_killed": Fault(_kill("sshd"), _start("sshd")),
    "relay_restarted": Fault(
        lambda context, target: context.cell(target).each(["relay"], "restart", timeout=15),
        _start("relay"),
    ),
    "cell_paused": Fault(
        lambda context, target: context.cell(target).each(SERVICES, "pause"), _unpause, weight=3
    ),
    "robots_cut": Fault(*_cut(_cut_robots), of_robots=True, weight=3),
    "database_cut": Fault(*_cut(_cut_database)),
    "peers_cut": Fault(*_cut(_cut_peers), weight=3),
    "clock_stepped": Fault(_step_clock(MOST_STEPPED_S), _step_clock(0.0)),
    "cell_drained": Fault(_order("drain"), _order("resume")),
    "database_away": Fault(_kill_database, _start_database, of_cell=False),
    "disk_full": Fault(
        _fill,
        lambda context, target: context.full(target).unlink(missing_ok=True),
        of_cell=False,
        of_robots=True,
        weight=1,
    ),
    "guards_killed": Fault(
        lambda context, target: context.robots[target.source].kill_guards(context.rng),
        # It mends itself.
        lambda _context, _target: None,
        of_cell=False,
        of_robots=True,
    ),
}
# With one of these no other is begun that takes something from another cell: one stays whole.
TAKES_A_CELL = frozenset(FAULTS) - {"disk_full", "guards_killed", "peers_cut"}
# Only this one may be beside another of them: a machine dies while one is out of service.
DRAINED = "cell_drained"


@dataclass
class _Open:
    name: str
    target: Target
    until_s: float


@dataclass
class Nemesis:
    context: Context
    history: History
    faults: Mapping[str, Fault] = field(default_factory=lambda: FAULTS)
    done: list[str] = field(default_factory=list)
    _open: list[_Open] = field(default_factory=list)

    async def run(self, seconds: float) -> None:
        """Break and mend for so long, and mend all at the end, whatever ends it."""
        end = time.monotonic() + seconds
        try:
            while time.monotonic() < end:
                await asyncio.sleep(self.context.rng.uniform(*BETWEEN_S))
                for fault in list(self._open):
                    if fault.until_s <= time.monotonic() or len(self._open) >= MOST_AT_ONCE:
                        await asyncio.to_thread(self._mend, fault)
                if (chosen := self.choose()) is not None:
                    await self.begin(*chosen)
            await asyncio.sleep(LASTS_S[0])
        finally:
            await asyncio.shield(asyncio.to_thread(self.mend_all))

    def choose(self) -> tuple[str, Target] | None:
        """The next fault: one that leaves a cell whole beside what is broken already; None: there is none."""
        rng = self.context.rng
        open_names = [item.name for item in self._open]
        names = [name for name in self.faults if name not in open_names and self._cells_for(name)]
        if not names:
            return None
        [name] = rng.choices(names, [self.faults[item].weight for item in names])
        fault = self.faults[name]
        cell = rng.choice(self._cells_for(name)) if fault.of_cell else ""
        source = rng.choice(sorted(self.context.robots)) if fault.of_robots else ""
        return name, Target(cell, source)

    def _cells_for(self, name: str) -> Sequence[str]:
        """The cells that a fault may concern; none while it may not begin."""
        cells = self.context.site.names
        takers = [fault for fault in self._open if fault.name in TAKES_A_CELL]
        if name not in TAKES_A_CELL or not takers:
            return cells
        is_with_drain = len(takers) == 1 and DRAINED in (name, takers[0].name)
        if not (is_with_drain and self.faults[name].of_cell and takers[0].target.cell):
            return []
        # A drained cell is resumed by its own web, which must work; and a third cell takes the robots.
        others = [item for item in cells if item != takers[0].target.cell]
        return others if len(others) > 1 else []

    async def begin(self, name: str, target: Target) -> None:
        lasts_s = self.context.rng.uniform(*LASTS_S)
        self._add("fault", name, target)
        self._open.append(_Open(name, target, time.monotonic() + lasts_s))
        self.done.append(name)
        await asyncio.to_thread(self.faults[name].do, self.context, target)

    def mend_all(self) -> None:
        """Mend what is broken still, the last first; what cannot be mended does not keep the others from it."""
        problems = []
        for fault in reversed(list(self._open)):
            try:
                self._mend(fault)
            except Exception as error:  # noqa: BLE001, PERF203 (the others must be mended)
                problems.append(error)
        if problems:
            raise RuntimeError(f"cannot mend all: {problems}") from problems[0]

    def _mend(self, item: _Open) -> None:
        self.faults[item.name].mend(self.context, item.target)
        self._open.remove(item)
        self._add("healed", item.name, item.target)

    def _add(self, kind: str, name: str, target: Target) -> None:
        self.history.add(kind, what=name, cell=target.cell, source=target.source)  # type: ignore[arg-type] # two of them


def make_disk(place: Path, size_bytes: int, folders: Sequence[Path]) -> None:
    place.mkdir()
    options = f"size={size_bytes},mode=0700"
    output_of_command("mount", "-t", "tmpfs", "-o", options, "robots", place)
    for folder in folders:
        shutil.copytree(folder, place / folder.parent.name / folder.name)


def remove_disk(place: Path) -> None:
    run_command("umount", "--lazy", place)
