"""Other people's programs: started inside a network, ended with all that they started, and what they compute."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import namespaces
import pytest
from link import why_not_here
from namespaces import Namespace
from openssh_server import is_alive, wait_until
from paper.peer_program import Program, cpu_between, cpu_s

needs_root = pytest.mark.skipif(bool(why_not_here()), reason=why_not_here() or "-")


@pytest.fixture
def place() -> Iterator[Namespace]:
    made = Namespace(f"{namespaces.PREFIX}-{os.getpid()}-900-program", "")
    namespaces.make(made)
    yield made
    namespaces.remove(made.name)


@needs_root
def test_a_program_ends_with_all_that_it_started(place: Namespace, tmp_path: Path) -> None:
    """Also with what would have outlived it."""
    words = ("sh", "-c", "trap '' TERM; sleep 60 & sleep 60 & echo both; trap - TERM; wait")
    program = Program(place, words, tmp_path / "log")
    wait_until(lambda: "both" in program.tail(), program.tail)
    pids = program.pids()
    assert len(pids) == 3
    program.end()
    assert not any(map(is_alive, pids))
    assert program.pids() == []


@needs_root
def test_one_that_ended_by_itself_is_told_with_its_last_words(
    place: Namespace, tmp_path: Path
) -> None:
    """A way that cannot be, says why."""
    program = Program(place, ("sh", "-c", "echo no such device; exit 3"), tmp_path / "log")
    wait_until(lambda: not program.pids(), program.tail)
    with pytest.raises(RuntimeError, match=r"ended with 3.*\n.*no such device"):
        program.check()
    program.end()


@needs_root
def test_it_runs_inside_with_its_environment(place: Namespace, tmp_path: Path) -> None:
    """The only network that it sees is the namespace's."""
    script = (
        "import os, socket; print([name for _, name in socket.if_nameindex()], os.environ['A'])"
    )
    program = Program(place, (sys.executable, "-c", script), tmp_path / "log", {"A": "b"})
    wait_until(lambda: "b" in program.tail(), program.tail)
    program.end()
    assert program.tail().startswith("['lo'")


def test_processor_time_of_this_process_grows() -> None:
    """And one that has ended is left out."""
    before = cpu_s([os.getpid(), 2**22 + 1])
    assert list(before) == [os.getpid()]
    wait_until(lambda: cpu_between(before, cpu_s(before)) > 0, lambda: "some time was computed")


def test_processor_time_between_two_looks() -> None:
    """A process that began meanwhile counts whole, one that ended not at all."""
    assert cpu_between({1: 2.0, 2: 5.0}, {1: 2.5, 3: 0.25}) == pytest.approx(0.75)
