"""Branch coverage of the product by its unit tests: .venv/bin/python tools/coverage.py.

coverage.py counts in the tests' workers and in the product's own processes; Node.js counts for the scripts. Prints a
line a package, and leaves tests/artifacts/coverage/summary.json.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "tests" / "artifacts" / "coverage"
PACKAGES = (
    "common/robotether_common",
    "agent/robotether_agent",
    "server/robotether_server",
    "images/sim_robot/sim_robot",
)
SCRIPTS = "server/frontend"
PYTEST = ("pytest", "-q", "-n", "2", "--timeout", "300", "tests/unit")


def main() -> None:
    """Run both, print the totals, and fail when a test did."""
    if "--help" in sys.argv:
        print(__doc__)
        return
    shutil.rmtree(RESULTS, ignore_errors=True)
    RESULTS.mkdir(parents=True)
    failed = run_python()
    totals = python_totals()
    failed = run_scripts() or failed
    totals[SCRIPTS] = script_totals()
    summary = {name: {**counts, "percent": percent(counts)} for name, counts in totals.items()}
    (RESULTS / "summary.json").write_text(json.dumps(summary, indent=1) + "\n")
    for name, counts in summary.items():
        print(
            f"{name:28} {counts['percent']:6.2f} %: {counts['covered_lines']} of {counts['lines']} lines, "
            f"{counts['covered_branches']} of {counts['branches']} branches"
        )
    if failed:
        sys.exit("some tests failed, so that these figures are of no use to compare")


def run_python() -> bool:
    """Run the unit tests and gather what all their processes counted; return whether a test failed."""
    # By pytest-cov, which gathers what the workers counted before they end; `coverage run` does so after.
    report = f"--cov-report=json:{RESULTS}/python.json"
    command = [sys.executable, "-m", *PYTEST, "--cov", report]
    return subprocess.run(command, cwd=ROOT, check=False).returncode != 0


def python_totals() -> dict[str, dict[str, int]]:
    """Add the files of each package up."""
    totals: dict[str, Counter[str]] = {package: Counter() for package in PACKAGES}
    for name, file in json.loads((RESULTS / "python.json").read_text())["files"].items():
        counts = file["summary"]
        package = next(package for package in PACKAGES if name.startswith(package + "/"))
        totals[package].update(
            lines=counts["num_statements"],
            covered_lines=counts["covered_lines"],
            branches=counts["num_branches"],
            covered_branches=counts["covered_branches"],
        )
    return {package: dict(counts) for package, counts in totals.items()}


def run_scripts() -> bool:
    """Run the scripts' tests with the Node.js that has their packages: this machine's or the image's."""
    if (ROOT / SCRIPTS / "node_modules").exists():
        command, folder = ["npm", "run", "--silent", "coverage"], ROOT / SCRIPTS
    else:
        command, folder = ["tools/test_frontend", "npm run --silent coverage"], ROOT
    with (RESULTS / "scripts.info").open("w") as output:
        return subprocess.run(command, cwd=folder, check=False, stdout=output).returncode != 0


def script_totals() -> dict[str, int]:
    """Add the scripts up; of one that no test loads, every line counts as one that is not covered."""
    totals, seen = Counter(lines=0, covered_lines=0, branches=0, covered_branches=0), set()
    names = {"LF": "lines", "LH": "covered_lines", "BRF": "branches", "BRH": "covered_branches"}
    source = ""
    for line in (RESULTS / "scripts.info").read_text().splitlines():
        key, _, value = line.partition(":")
        if key == "SF":
            source = value
            seen.add(source)
        elif key in names and source.startswith("src/"):
            totals[names[key]] += int(value)
    for path in (ROOT / SCRIPTS / "src").rglob("*.js"):
        if os.path.relpath(path, ROOT / SCRIPTS) not in seen:
            totals["lines"] += len(path.read_text().splitlines())
    return dict(totals)


def percent(counts: dict[str, int]) -> float:
    """Return what coverage.py calls the total: lines and branches together."""
    covered = counts["covered_lines"] + counts["covered_branches"]
    return round(100 * covered / (counts["lines"] + counts["branches"]), 2)


if __name__ == "__main__":
    main()
