"""Whether several cells keep their promises while they break, and what they carry.

A site of three cells, 30 agents and 300 virtual robots, all with the real guard; 10 drivers at 20 Hz, 10 observers and
operators who stop and release. A nemesis breaks things by a seed, which SEED in the environment sets. The history of
all is checked by rules (checker.py); one that breaks a rule is kept in tests/artifacts/cells.
"""

from __future__ import annotations

import asyncio
import json
import os
import secrets
import shutil
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import partial
from weakref import WeakKeyDictionary

from demo import ROOT

from paper.cells import steps
from paper.cells.checker import check, find_crowds, find_ignored_stops, find_returns
from paper.cells.history import read
from paper.cells.report import report
from paper.cells.site import Site
from paper.cells.workload import WRITES_WITHIN_S, Size, Workload, read_database
from paper.step import Part, Scale, Step, Values, now
from paper.world import World

KEPT = ROOT / "tests" / "artifacts" / "cells"
WHOLE = Size(cells=3, agents=30, virtual=300, drivers=10, observers=10, operators=3, seconds=600.0)
QUICK = Size(cells=2, agents=4, virtual=16, drivers=4, observers=2, operators=2, seconds=120.0)
FULL_S = 1800.0
AWAY_S, FULL_AWAY_S = 20.0, 600.0
SPREAD_ROBOTS, QUICK_SPREAD_ROBOTS = 40, 6
# Turns, and messages in each.
FORWARDED, QUICK_FORWARDED = (10, 200), (2, 20)
ONLINE_AGAIN_S = 120.0
MOST_VIOLATIONS = 30
# Without one of these a rule would have had nothing to judge.
JUDGED = ("arrived", "moved", "zeroed", "session", "stopped", "released", "stop_done", "recorded")
_sites: WeakKeyDictionary[World, Site] = WeakKeyDictionary()


def steps_of(scale: Scale) -> Sequence[Step]:
    whole = QUICK if scale.quick else WHOLE
    whole = replace(whole, seconds=FULL_S) if scale.full else whole
    some = QUICK_SPREAD_ROBOTS if scale.quick else SPREAD_ROBOTS
    forwarded = QUICK_FORWARDED if scale.quick else FORWARDED
    few = replace(whole, agents=2, virtual=18)
    return [
        _step("nemesis", f"{whole.seconds / 60:.3g} minutes of nemesis", whole.cells,
              lambda site: run_nemesis(site, whole)),
        _step("cell-killed", "a cell is killed", whole.cells,
              lambda site: steps.kill_cell(site, whole)),
        _step("database-away", "the database is away", whole.cells,
              lambda site: steps.database_away(site, few, FULL_AWAY_S if scale.full else AWAY_S)),
        _step("drain", "a cell is drained", whole.cells,
              lambda site: steps.drain(site, whole)),
        *(
            _step(f"spread-{count}", f"{count} cells at work", whole.cells,
                  partial(steps.spread, count=count, robots_a_cell=some))
            for count in range(1, whole.cells + 1)
        ),
        _step("forwarding", "messages through another cell", whole.cells,
              lambda site: steps.forwarding(site, few, *forwarded)),
    ]  # fmt: skip


def _step(name: str, title: str, cells: int, run: Callable[[Site], Values]) -> Step:
    return Step(name=name, title=title, run=lambda world: run(site_of(world, cells)))


def site_of(world: World, cells: int) -> Site:
    """The world's site, which is started for the first step and ends with the world."""
    if world not in _sites:
        _sites[world] = world.ends.enter_context(Site.started(world, cells))
    return _sites[world]


def run_nemesis(site: Site, size: Size) -> Values:
    """Break and mend while people are at work, and check the history of it."""
    seed = int(os.environ.get("SEED") or secrets.randbelow(1 << 32))
    # pytest shows it of a step that fails; the page and the folder's name have it, too.
    print(f"SEED={seed}")  # noqa: T201
    folder = KEPT / f"{now().replace(':', '')}-{seed}"
    with Workload.running(site, size, folder, seed) as workload:
        with workload.people() as people:
            done = asyncio.run(workload.nemesis(size.seconds))
            seen = people.seen()
            online_s = workload.wait_online(ONLINE_AGAIN_S)
            people.settle()
            time.sleep(WRITES_WITHIN_S)
            # What is released afterwards is no part of it.
            history, database = read(folder), read_database(site)
            people.end()
        failed = workload.failed
    violations = check(history, database)
    events = Counter(one.kind for one in history)
    unseen = [f"nobody saw an event {kind}" for kind in JUDGED if not events[kind]]
    values = {
        "seed": seed,
        "size": asdict(size),
        "faults": dict(Counter(done)),
        "events": dict(events),
        "violations": [asdict(one) for one in violations[:MOST_VIOLATIONS]],
        "broken": len(violations),
        "returns": [asdict(one) for one in find_returns(history, site.names)],
        "crowds": find_crowds(history),
        "ignored_stops_s": [round(one, 3) for one in find_ignored_stops(history)],
        "seen": seen,
        "failed": [*failed, *seen["failed"], *unseen],
        "online_s": online_s,
        "kept": "",
    }
    if violations or values["failed"]:
        values["kept"] = str(folder.relative_to(ROOT))
        (folder / "result.json").write_text(json.dumps(values, indent=1))
    else:
        shutil.rmtree(folder)
    return values


PART = Part(
    name="cells",
    title="Cells that break",
    steps=steps_of,
    report=lambda scale, results: report(results),
)
