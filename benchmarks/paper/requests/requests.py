"""Who is offered which request: the planner beside queueing theory, and beside the best that any schedule reaches.

Most requests are simulated, and the product's own `plan` decides. The last step has people at a site that breaks.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from random import Random

from report import Row, quantiles
from robotether_server.services.planning import PLAN_EVERY_S

from paper.requests.checker import PASSES_WITHIN_S
from paper.requests.nemesis import QueueSize, run_nemesis
from paper.requests.theory import (
    Job,
    Pools,
    erlang_c,
    least_waiting,
    poisson_jobs,
    simulate,
    waiting_quantile,
    weighted_waiting,
)
from paper.step import Comparison, Part, Report, Scale, Step, Values, against_aim, never

LOADS = (0.6, 0.8, 0.9)
OPERATORS, JOB_S, WRAP_UP_S = 10, 60.0, 30.0
PART_BELOW = 0.95
# Requests of a simulated queue, by quick and not; instances beside the optimum, and the requests of each.
REQUESTS, INSTANCES, OF_INSTANCE = {True: 20_000, False: 1_000_000}, {True: 5, False: 100}, 10
WHOLE = QueueSize(cells=2, calm_s=120.0, seconds=300.0)
QUICK = QueueSize(cells=2, calm_s=60.0, seconds=60.0)
MOST_SHOWN = 10
# Of issue 37.
AIM_THEORY_PERCENT, AIM_OF_OPTIMUM = 10.0, 0.95
LOAD_OF_INSTANCES = 0.7
PRIORITIES, SHARES = (1, 2, 3), (0.2, 0.5, 0.3)
POOLS: Mapping[str, float] = {"": 0.5, "arms": 0.3, "wheels": 0.2}
NOBODYS: Pools = frozenset()
SKILLED = (NOBODYS, frozenset({"arms"}), frozenset({"wheels"}), frozenset({"arms", "wheels"}))
# By their steps: the operators, whether all requests come at once, and what that shows.
KINDS: Mapping[str, tuple[Sequence[Pools], bool, str]] = {
    "at-once": (SKILLED, True, "pools, all at once"),
    "one-pool": ([NOBODYS] * len(SKILLED), False, "one pool, one after the other"),
    "pools": (SKILLED, False, "pools, one after the other"),
}


def steps_of(scale: Scale) -> Sequence[Step]:
    of_theory = [
        Step(
            name=f"erlang-{load}",
            title=f"Erlang C at load {load}",
            run=partial(run_queue, load, REQUESTS[scale.quick]),
        )
        for load in LOADS
    ]
    of_optimum = [
        Step(name=name, title=title, run=partial(run_instances, name, INSTANCES[scale.quick]))
        for name, (_, _, title) in KINDS.items()
    ]
    size = QUICK if scale.quick else WHOLE
    title = f"{size.seconds / 60:.3g} minutes of nemesis"
    return [
        *of_theory,
        *of_optimum,
        Step(name="nemesis", title=title, run=partial(run_nemesis, size)),
    ]


def run_queue(load: float, requests: int, _: object = None) -> Values:
    jobs = poisson_jobs(Random(load), requests, load * OPERATORS / JOB_S, JOB_S)
    operators = [NOBODYS] * OPERATORS
    at_once, planned = (
        sorted(simulate(jobs, operators, every_s)) for every_s in (0.0, PLAN_EVERY_S)
    )
    return {
        "load": load,
        "requests": requests,
        "share": sum(wait > 0 for wait in at_once) / requests,
        "at_once_s": at_once[int(PART_BELOW * requests)],
        "planned_s": planned[int(PART_BELOW * requests)],
    }


def run_instances(name: str, count: int, _: object = None) -> Values:
    operators, at_once, _title = KINDS[name]
    instances = [
        instance(Random(f"{name} {number}"), operators, at_once=at_once) for number in range(count)
    ]
    ours = [weighted_waiting(jobs, simulate(jobs, operators)) for jobs in instances]
    least = [least_waiting(jobs, operators) for jobs in instances]
    return {
        "instances": count,
        "ours": sum(ours) / count,
        "least": sum(least) / count,
        "best": sum(mine <= best + 1e-6 for mine, best in zip(ours, least, strict=True)),
    }


def instance(rng: Random, operators: Sequence[Pools], *, at_once: bool) -> list[Job]:
    takes_s = JOB_S + WRAP_UP_S
    rate = LOAD_OF_INSTANCES * len(operators) / takes_s
    pools = POOLS if any(operators) else {"": 1.0}
    made_s, jobs = 0.0, []
    for _ in range(OF_INSTANCE):
        made_s += 0.0 if at_once else round(rng.expovariate(rate))
        [priority] = rng.choices(PRIORITIES, SHARES)
        [pool] = rng.choices(list(pools), list(pools.values()))
        jobs.append(Job(made_s, takes_s, priority, pool))
    return jobs


def report(values: Mapping[str, Values]) -> Report:
    queues = [value for name, value in values.items() if name.startswith("erlang-")]
    instances = {name: values[name] for name in KINDS if name in values}
    return Report(
        values={
            "queues": [_queue_row(queue) for queue in queues],
            "instances": [_instance_row(name, value) for name, value in instances.items()],
            "of_instance": OF_INSTANCE,
            "nemesis": _nemesis(values["nemesis"]) if "nemesis" in values else None,
        },
        comparisons=[
            *(_against_theory(queue) for queue in queues),
            *(_against_optimum(name, value) for name, value in instances.items()),
            *(_against_rules(values["nemesis"]) if "nemesis" in values else ()),
        ],
        shortfalls=list(_broken_rules(values["nemesis"])) if "nemesis" in values else [],
    )


def _theory_s(queue: Values) -> float:
    return waiting_quantile(OPERATORS, queue["load"], JOB_S, PART_BELOW)


def _queue_row(queue: Values) -> Row:
    return {
        "load": queue["load"],
        "requests": queue["requests"],
        "have to wait, theory": erlang_c(OPERATORS, queue["load"]),
        "measured": queue["share"],
        "waiting p95, theory, s": _theory_s(queue),
        "planned at once, s": queue["at_once_s"],
        f"planned every {PLAN_EVERY_S:g} s, s": queue["planned_s"],
    }


def _instance_row(name: str, value: Values) -> Row:
    return {
        "instances": KINDS[name][2],
        "how many": value["instances"],
        "weighted waiting, planner, s": value["ours"],
        "optimum, s": value["least"],
        "the planner reaches": f"{100 * value['least'] / value['ours']:.0f} %",
        "is best itself in": value["best"],
    }


def _against_theory(queue: Values) -> Comparison:
    off = 100 * abs(queue["planned_s"] / _theory_s(queue) - 1)
    what = f"waiting p95 at load {queue['load']}: off the theory"
    return against_aim(what, AIM_THEORY_PERCENT, off, "%")


def _against_optimum(name: str, value: Values) -> Comparison:
    what = f"{KINDS[name][2]}: more weighted waiting than the optimum"
    more = 100 * (value["ours"] / value["least"] - 1)
    return against_aim(what, 100 * (1 / AIM_OF_OPTIMUM - 1), more, "%")


def _nemesis(run: Values) -> Values:
    faults = ", ".join(
        f"{name.replace('_', ' ')} ({times})" for name, times in run["faults"].items()
    )
    rows = [
        {"in the audit log": name.replace("_", " "), "times": times}
        for name, times in sorted(run["log"].items())
    ]
    late = {"offers without an answer": len(run["late_s"]), **quantiles(run["late_s"], 0.5, 1)}
    return {**run, "faults": faults, "log_rows": rows, "late_rows": [late]}


def _against_rules(run: Values) -> list[Comparison]:
    return [
        never("rules broken under the nemesis", run["broken"]),
        never("people who failed under the nemesis", len(run["failed"]), "people"),
        against_aim(
            "an offer's end until it passes on",
            PASSES_WITHIN_S,
            max(run["late_s"], default=None),
            "s",
        ),
    ]


def _broken_rules(run: Values) -> Iterator[str]:
    for violation in run["violations"][:MOST_SHOWN]:
        yield f"{violation['rule']}: {violation['robot']} {violation['words']}"
    yield from run["failed"][:MOST_SHOWN]


PART = Part(
    name="requests",
    title="Requests for help",
    steps=steps_of,
    report=report,
)
