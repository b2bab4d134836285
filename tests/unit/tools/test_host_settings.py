"""tools/host_settings, on a folder in the place of /proc/sys; and that nothing else changes the machine's kernel."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import namespaces
import pytest
from namespaces import Namespace
from stopping import MARK

ROOT = Path(__file__).resolve().parents[3]
TOOL = ROOT / "tools" / "host_settings"
INOTIFY = "fs/inotify/max_user_instances"
ALLOWED = "net/ipv4/tcp_allowed_congestion_control"
# As Debian's kernel boots.
FRESH = {INOTIFY: "128", ALLOWED: "reno cubic", "net/ipv4/tcp_congestion_control": "cubic"}
# What names a setting of the kernel: as a file, or as sysctl does.
NAMED = re.compile(r"/proc/sys/\w|\bsysctl\b|\bsysctls\b")
# These name some, and why none of them is the machine's.
ELSEWHERE = {
    "tests/support/networks/namespaces.py": "a network namespace's own",
    "tests/support/browser/browser_network.py": "a network namespace's own",
    "tests/support/networks/roaming.py": "a network namespace's own",
    "benchmarks/behind_video.py": "a network namespace's own",
    "benchmarks/video.py": "a network namespace's own",
    "benchmarks/paper/networks.py": "a network namespace's own",
    "benchmarks/paper/operators/operators.py": "a network namespace's own",
    "benchmarks/paper/peers/transports.py": "a network namespace's own",
    "tests/images/test_nginx.py": "a container's own, and only read",
    "tests/unit/deploy/test_swarm.py": "a container's own, and only compared",
}
# Each network has these for itself, so a namespace's change is no change of the machine.
OWN_TO_A_NETWORK = re.compile(
    r"net\.ipv4\.(ip_forward|tcp_congestion_control)|net\.ipv6\.conf\..*\.disable_ipv6"
)


@pytest.fixture
def proc_sys(tmp_path: Path) -> Path:
    """The settings of a kernel that has just booted."""
    for name, value in FRESH.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"{value}\n")
    return tmp_path


@pytest.fixture
def network() -> Iterator[Namespace | None]:
    """A network with a firewall of its own; only root's run looks at one."""
    if os.geteuid() != 0:
        yield None
        return
    made = Namespace(f"{namespaces.PREFIX}-{os.getpid()}-0-firewall", "")
    namespaces.make(made)
    yield made
    namespaces.remove(made.name)


@pytest.fixture
def run(proc_sys: Path, network: Namespace | None) -> Callable[[str], str]:
    """Run the tool there; returns what it said."""

    def tool(what: str) -> str:
        words = [str(TOOL), what]
        done = subprocess.run(
            network.command(*words) if network else words,
            env=os.environ | {"PROC_SYS": str(proc_sys)},
            capture_output=True,
            text=True,
            timeout=30,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    return tool


def values(proc_sys: Path) -> dict[str, str]:
    return {name: (proc_sys / name).read_text().strip() for name in FRESH}


def test_what_tests_need_is_set_and_put_back(run: Callable[[str], str], proc_sys: Path) -> None:
    """Each time once: a second run finds nothing to change."""
    run("needed")
    assert values(proc_sys) == FRESH | {INOTIFY: "512"}
    assert run("needed") == ""
    assert f"setting {INOTIFY} from '512' to '128'" in run("default")
    assert values(proc_sys) == FRESH
    assert run("default") == ""


def test_congestion_control_is_allowed_where_the_kernel_has_another_default(
    run: Callable[[str], str], proc_sys: Path
) -> None:
    """What is allowed by the kernel stays allowed; the default is what the kernel was built with, and reno."""
    (proc_sys / "net/ipv4/tcp_congestion_control").write_text("bbr\n")
    (proc_sys / ALLOWED).write_text("reno bbr\n")
    run("needed")
    assert values(proc_sys)[ALLOWED] == "reno bbr cubic"
    run("default")
    assert values(proc_sys)[ALLOWED] == "reno bbr"


def test_more_than_needed_is_left_alone(run: Callable[[str], str], proc_sys: Path) -> None:
    """Until `default`: an admin's larger value serves the tests too."""
    (proc_sys / INOTIFY).write_text("8192\n")
    run("needed")
    assert values(proc_sys)[INOTIFY] == "8192"
    run("default")
    assert values(proc_sys)[INOTIFY] == "128"


def test_container_without_the_machines_settings_is_no_failure(
    run: Callable[[str], str], proc_sys: Path
) -> None:
    """A network namespace does not show what the machine allows."""
    (proc_sys / ALLOWED).unlink()
    run("needed")
    run("default")


def test_continuous_integration_starts_from_the_kernels_defaults() -> None:
    """Before anything of ours runs, and so before ensure_test_hosts sets what tests need."""
    steps = [
        line.split()
        for line in (ROOT / ".ci/run").read_text().splitlines()
        if line.startswith(("tools/", "exec "))
    ]
    assert steps[0] == ["tools/host_settings", "default"]
    assert steps[-1] == ["exec", "make", "test"]


def named_by_us() -> dict[str, list[str]]:
    """Every line of tools, tests and benchmarks that names a setting of the kernel, by file."""
    found: dict[str, list[str]] = {}
    for folder in ("tools", "tests", "benchmarks", ".ci"):
        for path in sorted((ROOT / folder).rglob("*")):
            # What runs on a robot or server of the playbooks' tests is theirs: /proc/sys is read-only there.
            is_other = "ansible" in path.parts or path.suffix == ".pyc"
            if is_other or not path.is_file() or path in (TOOL, Path(__file__)):
                continue
            text = path.read_bytes().decode(errors="replace")
            if lines := [line.strip() for line in text.splitlines() if NAMED.search(line)]:
                found[str(path.relative_to(ROOT))] = lines
    return found


def test_nothing_else_changes_the_machines_kernel() -> None:
    """A setting that a test or benchmark makes by itself is missing where it has not run yet."""
    found = named_by_us()
    assert set(found) - set(ELSEWHERE) == set(), "let tools/host_settings set and reset it"
    assert set(ELSEWHERE) - set(found) == set(), "no longer needed here"
    for lines in found.values():
        for name in re.findall(r'sysctl\(f?"([^"]+)"', "\n".join(lines)):
            assert OWN_TO_A_NETWORK.fullmatch(name), f"{name} is the machine's"


@pytest.mark.skipif(os.geteuid() != 0, reason="a network namespace needs root")
def test_rules_that_a_killed_benchmark_left_are_removed(
    run: Callable[[str], str], network: Namespace
) -> None:
    """And no others; `stopping.py` is the one that drops packets on the machine, `site.py` does in containers."""
    add = ("iptables", "-w", "-t", "raw", "-I", "OUTPUT", "-p", "tcp", "--sport")
    network.run(*add, "1", "-j", "DROP")
    network.run(*add, "2", *MARK, "-j", "DROP")
    network.run(*add, "3", *MARK, "-j", "DROP")
    run("default")
    rules = network.run("iptables", "-w", "-t", "raw", "-S", "OUTPUT")
    assert [line for line in rules.splitlines() if "DROP" in line] == [
        "-A OUTPUT -p tcp -m tcp --sport 1 -j DROP"
    ]
    users = [
        path.name
        for folder in ("tests", "benchmarks")
        for path in (ROOT / folder).rglob("*.py")
        if '"iptables"' in path.read_text()
    ]
    assert set(users) == {"stopping.py", "site.py", Path(__file__).name}
