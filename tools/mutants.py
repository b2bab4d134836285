"""Mutation testing of what keeps robots safe: .venv/bin/python tools/mutants.py [SUBJECT ...].

Changes one thing at a time in a copy of the sources (mutmut) and runs the unit tests that execute it. A mutant that no
test notices shows a rule that nobody holds. Prints the score of each subject, killed / all, and the survivors.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import IO

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "tests" / "artifacts" / "mutants"
# In the copy they lie at the top: mutmut names a module after its path.
PACKAGES = {
    "robotether_common": "common/robotether_common",
    "robotether_agent": "agent/robotether_agent",
    "robotether_server": "server/robotether_server",
    "sim_robot": "images/sim_robot/sim_robot",
}
SUPPORT = tuple(f"tests/support/{name}" for name in ("fakes", "networks", "stack", "browser"))
AT_ONCE = 2
# A mutant may take so many times as long as its tests and this many seconds do.
TIMES_AS_LONG = 5
SECONDS_MORE = 2
# Lines that only speak to people: logs, and errors, which all begin so.
TEXTS = (r"^\s*log\.", r"[\"']cannot ")
KILLED = {1, 3}
TIMED_OUT = {24, -24, 36, 152, 255}


@dataclass(frozen=True)
class Subject:
    """Modules that are changed, and the tests that should notice."""

    modules: tuple[str, ...]
    tests: tuple[str, ...]

    def test_files(self) -> list[str]:
        """Name the files that the patterns in `tests` match."""
        return [
            str(path.relative_to(ROOT)) for name in self.tests for path in sorted(ROOT.glob(name))
        ]


RELAY = "robotether_server/relay"
RELAY_TESTS = "tests/unit/server/relay"
ROSBRIDGE = "channels/rosbridge"

# mutmut runs of these tests those that execute the changed function. The files are those whose subject the modules
# are, and those that reach the rest of them: nearly every other test of the relay executes them, too, and takes longer.
SUBJECTS = {
    "guard": Subject(
        ("robotether_agent/guard/*.py",),
        ("tests/unit/agent/guard", "tests/unit/transcripts/test_guard.py"),
    ),
    "leases": Subject(
        (f"{RELAY}/robots/lease.py", f"{RELAY}/control/leasing.py"),
        (
            f"{RELAY_TESTS}/robots/test_lease.py",
            f"{RELAY_TESTS}/control/test_leas*.py",
            f"{RELAY_TESTS}/{ROSBRIDGE}/test_ros_over_http.py",
        ),
    ),
    "access": Subject(
        (f"{RELAY}/auth/access.py",),
        (
            f"{RELAY_TESTS}/auth/test_access.py",
            f"{RELAY_TESTS}/channels/*/test_*handler.py",
            f"{RELAY_TESTS}/channels/test_recorder.py",
            f"{RELAY_TESTS}/{ROSBRIDGE}/test_ros_over_http.py",
            f"{RELAY_TESTS}/control/test_control_api.py",
            f"{RELAY_TESTS}/routes/test_apps.py",
            f"{RELAY_TESTS}/test_app.py",
        ),
    ),
    "policy": Subject(
        # The table itself is data, which is not changed; these apply it.
        (
            f"{RELAY}/{ROSBRIDGE}/message_validator.py",
            f"{RELAY}/{ROSBRIDGE}/operations.py",
            "robotether_common/ros.py",
        ),
        (
            f"{RELAY_TESTS}/{ROSBRIDGE}/test_*operations.py",
            f"{RELAY_TESTS}/{ROSBRIDGE}/test_message_*.py",
            f"{RELAY_TESTS}/{ROSBRIDGE}/test_bridge.py",
            "tests/unit/common/test_ros.py",
            "tests/unit/agent/test_rosbridge.py",
        ),
    ),
    "stops": Subject(
        (f"{RELAY}/control/stops.py", f"{RELAY}/robots/robot_stops.py"),
        (f"{RELAY_TESTS}/control/test_stop*.py", f"{RELAY_TESTS}/test_main.py"),
    ),
    "tickets": Subject(("robotether_server/tickets.py",), ("tests/unit/server/test_tickets.py",)),
}


def main() -> None:
    """Measure all subjects, or those that are named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("subjects", nargs="*", metavar="SUBJECT", help=", ".join(SUBJECTS))
    names = parser.parse_args().subjects or list(SUBJECTS)
    if unknown := sorted(set(names) - set(SUBJECTS)):
        parser.error(f"no such subject: {', '.join(unknown)}; there are {', '.join(SUBJECTS)}")
    lines = [measure(name, SUBJECTS[name]) for name in names]
    print("\n" + "\n".join(lines))


def measure(name: str, subject: Subject) -> str:
    """Run all mutants of a subject; return its line of the summary."""
    began = time.monotonic()
    tree = RESULTS / name
    copy_sources(tree)
    write_settings(tree, subject)
    with (RESULTS / f"{name}.log").open("w") as log:
        done = run(tree, mutmut("run", f"--max-children={AT_ONCE}"), log)
    if done.returncode:
        sys.exit(f"cannot measure {name}: mutmut failed; see {log.name}")
    codes = exit_codes(tree)
    if None in codes.values():
        sys.exit(f"cannot measure {name}: not every mutant was run; see {log.name}")
    killed = sum(code in KILLED | TIMED_OUT for code in codes.values())
    survivors = sorted(mutant for mutant, code in codes.items() if code not in KILLED | TIMED_OUT)
    for mutant in survivors:
        show = run(tree, mutmut("show", mutant), subprocess.PIPE)
        print(show.stdout.strip(), end="\n\n", flush=True)
    summary = {
        "killed": killed,
        "timed_out": sum(code in TIMED_OUT for code in codes.values()),
        "all": len(codes),
        "score": round(killed / len(codes), 4),
        "seconds": round(time.monotonic() - began),
        "survivors": survivors,
    }
    (RESULTS / f"{name}.json").write_text(json.dumps(summary, indent=1) + "\n")
    return f"{name:8} {killed:5} of {len(codes):5} killed: {killed / len(codes):.1%} ({summary['seconds']} s)"


def copy_sources(tree: Path) -> None:
    """Copy what git knows or would take, with the packages at the top."""
    shutil.rmtree(tree, ignore_errors=True)
    listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    for file in subprocess.run(
        listed, cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.split("\0"):
        if file and (ROOT / file).is_file():
            (tree / file).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / file, tree / file)
    for package, place in PACKAGES.items():
        shutil.move(tree / place, tree / package)


def write_settings(tree: Path, subject: Subject) -> None:
    """Tell mutmut what to change, and pytest where the packages lie."""
    others = [path.name for path in tree.iterdir() if path.name not in PACKAGES]
    settings = {
        "source_paths": list(PACKAGES),
        "only_mutate": subject.modules,
        "also_copy": others,
        "do_not_mutate_patterns": TEXTS,
        "pytest_add_cli_args_test_selection": subject.test_files(),
        "pytest_add_cli_args": [
            *("-m", "not daemon"),
            *("-o", f"pythonpath=. benchmarks {' '.join(SUPPORT)}"),
            *("-p", "no:cacheprovider"),
        ],
    }
    lines = ["[mutmut]", "use_setproctitle = false", "use_git_change_detection = false"]
    lines += [f"timeout_multiplier = {TIMES_AS_LONG}", f"timeout_constant = {SECONDS_MORE}"]
    for key, values in settings.items():
        lines += [f"{key} =", *(f"  {value}" for value in values)]
    (tree / "setup.cfg").write_text("\n".join(lines) + "\n")


def mutmut(*arguments: str) -> list[str]:
    """Build a command of mutmut."""
    return [str(Path(sys.executable).with_name("mutmut")), *arguments]


def run(tree: Path, command: list[str], output: IO[str] | int) -> subprocess.CompletedProcess[str]:
    """Run a command in the copy; property tests play the same examples for each mutant."""
    environ = os.environ | {"CI": "true"}
    return subprocess.run(command, check=False, cwd=tree, env=environ, stdout=output, text=True)


def exit_codes(tree: Path) -> dict[str, int | None]:
    """Read how the tests of each mutant ended."""
    codes: dict[str, int | None] = {}
    for path in (tree / "mutants").rglob("*.meta"):
        codes |= json.loads(path.read_text())["exit_code_by_key"]
    return codes


if __name__ == "__main__":
    main()
