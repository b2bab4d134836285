"""What containers and processes have used, as the kernel writes it."""

from __future__ import annotations

from pathlib import Path

from paper import costs
from paper.costs import Group, Reading, Use

USE = Use(
    cpu_s=2.0,
    memory_bytes=100,
    memory_limit_bytes=1000,
    memory_failures=0,
    processes=5,
    processes_limit=50,
)
FIRST = Reading(
    at_s=1.0, services={"sshd": USE}, robots_cpu_s=3.0, operators_cpu_s=1.0, machine_cpu_s=100.0
)


def write(folder: Path, **files: str) -> None:
    folder.mkdir(parents=True)
    for name, text in files.items():
        (folder / name.replace("__", ".")).write_text(text + "\n")


def test_a_group_of_the_first_kind(tmp_path):
    write(
        tmp_path / "proc/7",
        cgroup="4:memory:/docker/x\n2:cpu,cpuacct:/docker/x\n8:pids:/docker/x\n0::/docker/x",
    )
    write(
        tmp_path / "groups/memory/docker/x",
        memory__stat="cache 9\ntotal_rss 4000\nrss 1",
        memory__kmem__usage_in_bytes="500",
        memory__limit_in_bytes="9223372036854771712",
        memory__failcnt="3",
    )
    write(tmp_path / "groups/cpuacct/docker/x", cpuacct__usage="2500000000")
    write(tmp_path / "groups/pids/docker/x", pids__current="11", pids__max="16384")
    group = Group(7, proc=tmp_path / "proc", groups=tmp_path / "groups")
    assert group.use() == Use(2.5, 4500, None, 3, 11, 16384)


def test_a_group_of_the_second_kind(tmp_path):
    write(tmp_path / "proc/7", cgroup="0::/system.slice/x")
    write(
        tmp_path / "groups/system.slice/x",
        memory__stat="anon 4000\nfile 70\nkernel 500",
        memory__events="low 0\nmax 2",
        memory__max="1000000",
        cpu__stat="usage_usec 1500000\nuser_usec 1",
        pids__current="4",
        pids__max="max",
    )
    group = Group(7, proc=tmp_path / "proc", groups=tmp_path / "groups")
    assert group.use() == Use(1.5, 4500, 1000000, 2, 4, None)


def test_processes_count_with_what_they_started(tmp_path, monkeypatch):
    ticks = costs.TICKS_PER_S
    rows = {1: (0, 900, 0), 10: (1, ticks, ticks), 11: (10, 2 * ticks, 0), 12: (1, 500, 0)}
    for pid, (parent, own, of_ended) in rows.items():
        fields = ["S", str(parent), *["0"] * 9, str(own), "0", str(of_ended), "0", "20"]
        write(tmp_path / str(pid), stat=f"{pid} (a (b) c) {' '.join(fields)}")
    monkeypatch.setattr(costs, "PROC", tmp_path)
    assert costs.trees_cpu_s([10, 99]) == [4.0, 0.0]
