"""Whether no request is lost or given to two while web, relay and database of a site break.

The nemesis of the cells breaks the site. First nothing is broken, so that there are offers whose operators have left.
"""

from __future__ import annotations

import asyncio
import os
import time
from collections import Counter
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from random import Random

from demo import ROOT

from paper.cells.history import History, read
from paper.cells.nemesis import FAULTS, Context, Nemesis
from paper.cells.site import Site
from paper.cells.workload import at_work, judged, new_run
from paper.requests.checker import Record, Records, check, find_late_passes
from paper.requests.people import SETTLED_WITHIN_S
from paper.step import Values
from paper.world import World, local_mac

KEPT = ROOT / "tests" / "artifacts" / "requests"
# Those that concern no robot's connection.
FAULTS_HERE = (
    "cell_killed",
    "cell_paused",
    "clock_stepped",
    "database_away",
    "database_cut",
    "peers_cut",
    "relay_killed",
    "relay_restarted",
)
ENDS_WITHIN_S = 30.0


@dataclass(frozen=True, kw_only=True)
class QueueSize:
    cells: int
    robots: int = 200
    operators: int = 10
    # Before anything is broken, and with the nemesis.
    calm_s: float
    seconds: float


def run_nemesis(size: QueueSize, world: World) -> Values:
    seed, folder = new_run(KEPT)
    with Site.started(world, size.cells) as site:
        done, seen = _run(site, size, folder, seed)
        records = read_records(site)
    history = read(folder)
    violations = check(history, records)
    late_s = [late for _, late in find_late_passes(history, records)]
    values = {
        "seed": seed,
        "size": asdict(size),
        "faults": dict(Counter(done)),
        "log": dict(Counter(record.kind for record in records.log)),
        "late_s": late_s,
        "failed": seen["failed"],
    }
    return judged(folder, violations, values)


def _run(site: Site, size: QueueSize, folder: Path, seed: int) -> tuple[list[str], Values]:
    history = History.open(folder, "nemesis")
    with (
        closing(history),
        at_work("paper.requests.people", folder, _order(site, size, folder, seed)) as people,
    ):
        time.sleep(size.calm_s)
        faults = {name: FAULTS[name] for name in FAULTS_HERE}
        nemesis = Nemesis(Context(site, {}, Random(seed)), history, faults)
        asyncio.run(nemesis.run(size.seconds))
        people.send("settle")
        seen = people.receive("that no request is open", SETTLED_WITHIN_S + ENDS_WITHIN_S)
        people.send("end")
        people.receive("that people have ended", ENDS_WITHIN_S)
    return nemesis.done, dict(seen)


def _order(site: Site, size: QueueSize, folder: Path, seed: int) -> Values:
    return {
        "folder": str(folder),
        "seed": seed,
        "cells": site.addresses,
        "admin": site.world.token,
        "operators": site.people("x-queue", size.operators),
        "robots": _add_robots(site, size.robots),
    }


def _add_robots(site: Site, count: int) -> list[str]:
    names = site.world.names("requests", count)
    rows = ", ".join(
        f"('{local_mac(os.getpid(), 40_000 + number)}', '{name}', 'active')"
        for number, name in enumerate(names)
    )
    site.sql(f"INSERT INTO robots (mac, name, state) VALUES {rows}")
    return names


def read_records(site: Site) -> Records:
    """Read the requests and their log, with the times in the history's clock, which is this machine's."""
    requests = site.sql(
        "SELECT q.id, q.state, IFNULL(u.name, '') FROM help_requests q LEFT JOIN users u ON u.id = q.accepted_by"
    )
    log = site.sql(
        "SELECT UNIX_TIMESTAMP(at), JSON_VALUE(details, '$.request'), kind,"
        " IFNULL(JSON_VALUE(details, '$.user'), actor)"
        " FROM audit_events WHERE kind LIKE 'request\\_%' ORDER BY id"
    )
    ahead_s = time.time() - time.monotonic()
    return Records(
        requests={number: (state, user) for number, state, user in requests},
        log=[
            Record(at_s=float(at) - ahead_s, request=request, kind=kind, user=user)
            for at, request, kind, user in log
        ],
    )
