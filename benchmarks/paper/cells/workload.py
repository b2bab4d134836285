"""Robots, people and nemesis of one run at a site, each from its begin to its end, and what the database says of it."""

from __future__ import annotations

import asyncio
import json
import os
import secrets
import shutil
import sys
import time
import urllib.request
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from random import Random
from typing import Any

from demo import ROOT
from local_network import insecure_tls
from namespaces import Namespace

from paper.cells.checker import Database, Violation
from paper.cells.history import History
from paper.cells.nemesis import GUARDS_SHARE, Context, Nemesis, make_disk, remove_disk
from paper.cells.site import Cell, Site
from paper.client import TOPIC, TYPE
from paper.fleet.fleet import Share, Worker, shares
from paper.programs import LineProgram
from paper.step import Values, now
from paper.world import Enrolled

RATE_HZ = 20
MOST_AGENTS_IN_A_WORKER = 15
# A key, an enrolment, a fence and a stop of each robot, in pages of 4 KB; and some for what is written anew beside.
DISK_BYTES_A_ROBOT = 64 * 1024
HOT_ROBOTS = 6
OPENS_WITHIN_S, ENDS_WITHIN_S, DONE_WITHIN_S = 120.0, 60.0, 30.0
ONLINE_WITHIN_S, ASK_EVERY_S = 240.0, 0.5
# What the relays have to write after everything was mended, and what an operator needs to have the last word.
WRITES_WITHIN_S, SETTLES_WITHIN_S = 20.0, 240.0
SETTLES_S = 20.0
MOST_VIOLATIONS = 30


@dataclass(frozen=True, kw_only=True)
class Size:
    cells: int
    agents: int
    virtual: int
    drivers: int = 0
    observers: int = 0
    operators: int = 0
    seconds: float = 0.0


class RobotProcess(Worker):
    """Robots in one process, in a network and on a disk of their own; the nemesis' Robots."""

    def __init__(
        self, source: str, uplink: Namespace, share: Share, folder: Path, place: Path
    ) -> None:
        robots = [*share[0], *share[1]]
        self.source = source
        self.disk = place / f"disk-{source}"
        self.names = [robot.name for robot in robots]
        self.inside = uplink.command
        folders = [robot.state_dir for robot in robots]
        make_disk(self.disk, DISK_BYTES_A_ROBOT * len(robots), folders)
        agents, virtual = ({robot.name: self._settings(robot) for robot in some} for some in share)
        worker_settings = {
            "folder": str(folder),
            "source": source,
            "agents": agents,
            "virtual": virtual,
        }
        super().__init__(uplink, place / f"{source}.log", worker_settings, "paper.cells.worker")

    def __enter__(self) -> RobotProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self.end(ENDS_WITHIN_S)
        remove_disk(self.disk)

    def kill_guards(self, rng: Random) -> None:
        some = rng.sample(self.names, max(1, round(len(self.names) * GUARDS_SHARE)))
        self.do("kill_guards", DONE_WITHIN_S, robots=some)

    def _settings(self, robot: Enrolled) -> dict[str, str]:
        state_dir = self.disk / robot.name / robot.state_dir.name
        return {**robot.settings, "state_dir": str(state_dir)}


class Workload:
    def __init__(
        self, site: Site, size: Size, folder: Path, seed: int, processes: Sequence[RobotProcess]
    ) -> None:
        self.site, self.size, self.folder, self.seed = site, size, folder, seed
        self.robots = [robot.name for robot in site.world.robots(size.agents + size.virtual)]
        self.cameras = self.robots[: size.agents]
        # The second follows the first by a route, and nobody else drives or stops them.
        self.routed = self.robots[HOT_ROBOTS // 2 :][:2]
        self.processes = {process.source: process for process in processes}

    @classmethod
    @contextmanager
    def running(cls, site: Site, size: Size, folder: Path, seed: int) -> Iterator[Workload]:
        robots = site.world.robots(size.agents + size.virtual)
        parts = shares(robots, size.agents, MOST_AGENTS_IN_A_WORKER)
        with ExitStack() as stack:
            uplinks = stack.enter_context(site.world.uplinks(len(parts)))
            place = site.world.folder / f"run-{time.monotonic_ns()}"
            place.mkdir()
            stack.callback(shutil.rmtree, place, ignore_errors=True)
            processes = [
                stack.enter_context(RobotProcess(f"robots-{at}", uplink, share, folder, place))
                for at, (uplink, share) in enumerate(zip(uplinks, parts, strict=True), 1)
            ]
            workload = cls(site, size, folder, seed, processes)
            workload.start()
            yield workload

    def start(self) -> None:
        for process in self.processes.values():
            process.has_done("open", OPENS_WITHIN_S)
        cells = {f"{at.host}:{port}": at.name for at in self.site.cells for port in at.ssh_ports}
        for process in self.processes.values():
            process.do("start", DONE_WITHIN_S, cells=cells)
        self.wait_online(ONLINE_WITHIN_S)
        source, target = self.routed
        topics = {"source_topic": TOPIC, "target_topic": TOPIC, "type": TYPE}
        self.site.world.ask("POST", "/routes", {"source": source, "target": target, **topics})

    def end_route(self) -> list[str]:
        """Remove the route, which ends its drive; return why it has ended already, if it has."""
        [route] = self.site.world.ask("GET", "/routes")["routes"]
        self.site.world.ask("DELETE", f"/routes/{route['id']}")
        return [f"the route ended: {route['end_code']}"] if route["ended_at"] else []

    def wait_online(self, within_s: float) -> float:
        """Wait until each of the cells says that all robots are online; return the seconds that it took."""
        began = time.monotonic()
        missing: Mapping[str, set[str]] = {}
        while time.monotonic() - began < within_s:
            missing = {
                cell.name: set(self.robots) - self.online_at(cell) for cell in self.site.cells
            }
            if not any(missing.values()):
                return round(time.monotonic() - began, 3)
            time.sleep(ASK_EVERY_S)
        shown = {name: sorted(some)[:5] for name, some in missing.items() if some}
        logs = "\n".join(process.tail() for process in self.processes.values())
        counts = {name: len(some) for name, some in missing.items()}
        raise RuntimeError(
            f"robots are not online within {within_s:g} s: {counts}, such as {shown}\n{logs}"
        )

    def online_at(self, cell: Cell) -> set[str]:
        request = urllib.request.Request(
            f"https://{cell.address}/api/v1/events",
            headers={"Authorization": f"Bearer {self.site.world.token}"},
        )
        try:
            with urllib.request.urlopen(request, context=insecure_tls(), timeout=5) as answer:
                for line in answer:
                    if line.startswith(b"data: "):
                        fleet = json.loads(line.removeprefix(b"data: "))
                        return {item["name"] for item in fleet if item["online"]}
        except OSError:
            pass
        return set()

    def order(self) -> dict[str, Any]:
        return {
            **{
                kind: self.site.people(f"x-{kind}", getattr(self.size, kind))
                for kind in ("drivers", "observers", "operators")
            },
            "folder": str(self.folder),
            "seed": self.seed,
            "cells": self.site.addresses,
            "admin": self.site.world.token,
            "robots": [name for name in self.robots if name not in self.routed],
            "source": self.routed[0],
            # Agents and virtual ones.
            "hot": [*self.robots[: HOT_ROBOTS // 2], *self.robots[-HOT_ROBOTS // 2 :]],
            "cameras": self.cameras,
            "rate_hz": RATE_HZ,
            "prefix": f"x{self.seed}",
        }

    async def nemesis(self, seconds: float) -> Sequence[str]:
        """Break and mend for so long, then let things settle; return what was done, in its order."""
        context = Context(self.site, self.processes, Random(self.seed))
        history = History.open(self.folder, "nemesis")
        nemesis = Nemesis(context, history)
        try:
            await nemesis.run(seconds)
        finally:
            history.close()
        await asyncio.sleep(SETTLES_S)
        return nemesis.done

    @property
    def failed(self) -> list[str]:
        return [words for process in self.processes.values() for words in process.failed]


@contextmanager
def at_work(module: str, folder: Path, order: Values) -> Iterator[LineProgram]:
    """A process of people who have begun; its log stays when it fails."""
    log = folder.parent / f"people-{os.getpid()}.log"
    program = LineProgram(module, log)
    try:
        program.send(order)
        program.receive("that people have begun", OPENS_WITHIN_S)
        yield program
    finally:
        program.end(DONE_WITHIN_S)
    log.unlink()


def new_run(place: Path) -> tuple[int, Path]:
    seed = int(os.environ.get("SEED") or secrets.randbelow(1 << 32))
    sys.stderr.write(f"SEED={seed}\n")
    folder = place / f"{now().replace(':', '')}-{seed}"
    folder.mkdir(parents=True)
    return seed, folder


def judged(folder: Path, violations: Sequence[Violation], values: Values) -> Values:
    """The values of a run with its violations; its folder is kept if a rule is broken, or something failed."""
    values = {
        **values,
        "violations": [asdict(violation) for violation in violations[:MOST_VIOLATIONS]],
        "broken": len(violations),
        "kept": str(folder.relative_to(ROOT)) if violations or values["failed"] else "",
    }
    if values["kept"]:
        (folder / "result.json").write_text(json.dumps(values, indent=1))
    else:
        shutil.rmtree(folder)
    return values


def read_database(site: Site) -> Database:
    rows = site.sql
    drives = rows("SELECT robot, fence FROM drives")
    fences = rows("SELECT r.name, l.fence FROM control_leases l JOIN robots r ON r.id = l.robot_id")
    reasons = rows(
        "SELECT JSON_VALUE(details, '$.reason') FROM audit_events WHERE kind = 'robot_stopped'"
    )
    recorded = rows(
        "SELECT s.name FROM sites s JOIN audit_events a"
        " ON a.kind = 'site_added' AND JSON_VALUE(a.details, '$.site') = s.name"
    )
    stopped = rows("SELECT r.name FROM robot_stops s JOIN robots r ON r.id = s.robot_id")
    sessions = rows(
        "SELECT r.name, COUNT(*) FROM robot_sessions s JOIN robots r ON r.id = s.robot_id"
        " WHERE s.ended_at IS NULL GROUP BY r.name"
    )
    return Database(
        drives={(robot, int(fence)) for robot, fence in drives},
        fences={robot: int(fence) for robot, fence in fences},
        stop_reasons={reason for [reason] in reasons},
        recorded={entry for [entry] in recorded},
        stopped={item for [item] in stopped},
        open_sessions={robot: int(count) for robot, count in sessions},
    )
