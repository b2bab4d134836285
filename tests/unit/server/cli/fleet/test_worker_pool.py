"""Work for many at once."""

from __future__ import annotations

from threading import Barrier, Event, Lock

from robotether_server.cli.fleet.worker_pool import WorkerPool

NAMES = [f"sim{number}" for number in range(9)]


def test_every_name_is_done_once() -> None:
    """With fewer threads than names, and with more."""
    for parallel in (1, 4, 20):
        assert sorted(WorkerPool(str.upper, NAMES, parallel).results()) == [
            n.upper() for n in NAMES
        ]
    assert list(WorkerPool(str.upper, [], 4).results()) == []


def test_as_many_at_a_time_as_asked() -> None:
    """Three meet at the barrier, and never four."""
    barrier, lock = Barrier(3, timeout=10), Lock()
    at_work: list[int] = []
    most = [0]

    def work(name: str) -> str:
        with lock:
            at_work.append(1)
            most[0] = max(most[0], len(at_work))
        barrier.wait()
        with lock:
            at_work.pop()
        return name

    assert len(list(WorkerPool(work, NAMES, 3).results())) == 9
    assert most[0] == 3


def test_stop_begins_nothing_new() -> None:
    """It returns what those at work bring in time, and waits for no other."""
    going, ending = Event(), Event()
    begun: list[str] = []

    def work(name: str) -> str:
        begun.append(name)
        going.set()
        ending.wait(10)
        return name

    pool = WorkerPool(work, NAMES, 1)
    results = pool.results()
    for thread in pool._threads:
        thread.start()
    assert going.wait(10)
    assert pool.stop(0.01) == []
    ending.set()
    assert pool.stop(10) == ["sim0"]
    assert begun == ["sim0"]
    results.close()
