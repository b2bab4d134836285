"""`make experiments`: which steps run, against which stack, and the pages that are written after them.

Each step is a test of experiments.py. What became of it is kept at once, so that a run that was interrupted goes on
where it was; a finished one starts anew. pytest's -k chooses among all steps by part and name.
"""

from __future__ import annotations

import platform
import re
import subprocess
from collections.abc import Iterator, Mapping
from typing import Any

import pytest
from demo import ROOT
from report import cell, commit, machine

from paper.page import Chapter, chapter, write_page
from paper.step import Key, ResultStore, Scale
from paper.world import World

ARTIFACTS = ROOT / "tests" / "artifacts"
PAGES, QUICK_PAGES = ROOT / "docs" / "experiments", ARTIFACTS / "experiments-quick"
# Service, what its daemon is called, and the command that tells its version.
DAEMONS = (
    ("nginx", "nginx", "nginx -v"),
    ("sshd", "OpenSSH", "ssh -V"),
    ("mysql", "MariaDB", "mariadbd --version"),
    ("relay", "Python of web and relay", "python3 --version"),
)
# What interrupts a run, or keeps it from its begin, writes no page.
FINISHED = (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED, pytest.ExitCode.NO_TESTS_COLLECTED)
_VERSION = re.compile(r"\d+\.\d[\w.]*")
STORE = pytest.StashKey[ResultStore]()
# The steps of this run, with those that have run before.
ASKED = pytest.StashKey[set[Key]]()
SUMMARY = pytest.StashKey[list[str]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    add = parser.getgroup("experiments").addoption
    add("--quick", action="store_true", help="all of it small; the page goes to tests/artifacts")
    add("--full", action="store_true", help="what lasts, for longer")
    add("--restart", action="store_true", help="measure anew what an earlier run has measured")


def scale_of(config: pytest.Config) -> Scale:
    return Scale(quick=config.getoption("quick"), full=config.getoption("full"))


def pytest_configure(config: pytest.Config) -> None:
    store = config.stash[STORE] = ResultStore(ARTIFACTS / "experiments", scale_of(config))
    try:
        store.lock()
    except BlockingIOError as error:
        raise pytest.UsageError(
            "cannot measure: another run of the same scale is measuring; wait or stop it"
        ) from error


def pytest_report_header(config: pytest.Config) -> str:
    return f"results go to {config.stash[STORE].path}"


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Function]) -> None:
    """Leave out what has run; when that is all, run it all again."""
    store = config.stash[STORE]
    asked = config.stash[ASKED] = {key_of(item) for item in items}
    if config.getoption("restart") or asked <= store.keys():
        store.set_aside(asked)
    waiting = asked - store.keys()
    config.hook.pytest_deselected(items=[entry for entry in items if key_of(entry) not in waiting])
    items[:] = [entry for entry in items if key_of(entry) in waiting]


def key_of(item: pytest.Function) -> Key:
    given: Mapping[str, Any] = item.callspec.params
    return given["part"].name, given["step"].name


@pytest.fixture(scope="session")
def world() -> Iterator[World]:
    with World.own() as world:
        yield world


@pytest.fixture(scope="session")
def store(request: pytest.FixtureRequest) -> ResultStore:
    return request.config.stash[STORE]


@pytest.fixture(scope="session")
def circumstances(world: World) -> Mapping[str, str]:
    """The sources, the machine and the versions that outcomes of this run have."""
    here = machine()
    return {
        "commit": commit(),
        "machine": f"{here['processor']}, {here['cores']} cores, {here['memory_gb']} GB of memory, "
        f"Linux {here['kernel']}",
        "versions": ", ".join(f"{name} {version}" for name, version in versions(world).items()),
    }


def versions(world: World) -> dict[str, str]:
    """What runs: the stack's daemons, and on this machine Docker, OpenSSH's client and Python."""
    # Most daemons tell their versions on stderr.
    of_stack = {
        name: world.exec(service, "sh", "-c", f"{ask} 2>&1") for service, name, ask in DAEMONS
    }
    client = subprocess.run(["ssh", "-V"], capture_output=True, text=True, check=True).stderr
    found = {name: _VERSION.search(text) for name, text in of_stack.items()}
    return {
        **{name: item[0] if item else of_stack[name] for name, item in found.items()},
        "OpenSSH of the robots": " ".join(_VERSION.findall(client)[:1]),
        "Python of robots and experiments": platform.python_version(),
        "Docker": str(world.engine.version()["Version"]),
    }


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Write the pages, and fail where a step has failed, now or before, or a figure that has to be met is not."""
    config = session.config
    if config.option.collectonly or exitstatus not in FINISHED:
        return
    from paper.experiments import PARTS

    scale, store = scale_of(config), config.stash[STORE]
    chapters = [chapter(part, scale, store) for part in PARTS]
    folder = QUICK_PAGES if scale.quick else PAGES
    pages = [write_page(folder, item, scale) for item in chapters if item.outcomes]
    parts = {part for part, _ in config.stash[ASKED]}
    asked = [item for item in chapters if item.part.name in parts]
    config.stash[SUMMARY] = [
        *(line for item in asked for line in summary(item)),
        *(f"a page is {page}" for page in pages),
    ]
    session.exitstatus = (
        pytest.ExitCode.OK if all(item.is_fine for item in asked) else pytest.ExitCode.TESTS_FAILED
    )


def summary(item: Chapter) -> Iterator[str]:
    """A line on the part, and one for each thing besides failures of steps that makes the exit status 1."""
    good = len(item.outcomes) - len(item.failed)
    failed = f"{len(item.failed)} failed, {len(item.missing)} have not run"
    yield f"{item.part.name}: {good} of {len(item.steps)} steps succeeded, {failed}"
    yield from (f"  {line}" for line in item.problems)
    for row in item.unmet:
        yield f"  {row.what} is {cell(row.ours)} and has to be {cell(row.reference)} {row.unit}"


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    for line in config.stash.get(
        SUMMARY, ["no page was written; the same command goes on where it was"]
    ):
        terminalreporter.write_line(line)
