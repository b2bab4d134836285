"""The newest number of a lease in memory and on the disk."""

from __future__ import annotations

import asyncio
import logging
import threading
from pathlib import Path

import pytest
from robotether_agent.guard.fences import FenceFile, FenceStore
from robotether_agent.problems import StateUnusableError
from sim_client import until


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"fence": "3"}', '{"fence": -1}', "\udcff"])
def test_a_number_that_cannot_be_read_is_none(tmp_path, text, caplog):
    (tmp_path / "fence.json").write_bytes(text.encode(errors="surrogateescape"))
    assert FenceFile(tmp_path).read() == 0
    assert "so the server's number counts" in caplog.text
    FenceFile(tmp_path).write(3)
    assert FenceFile(tmp_path).read() == 3


class SlowFile(FenceFile):
    def __init__(self, state_dir: Path) -> None:
        super().__init__(state_dir)
        self.go = threading.Event()
        self.begun = list[int]()

    def write(self, fence: int) -> None:
        self.begun.append(fence)
        assert self.go.wait(5)
        super().write(fence)


async def test_a_newer_number_waits_for_the_disk_and_an_older_one_does_not(tmp_path: Path) -> None:
    FenceFile(tmp_path).write(13)
    file = SlowFile(tmp_path)
    store = FenceStore(file)
    await store.keep(13)
    keeping = asyncio.create_task(store.keep(14))
    await until("it writes", lambda: file.begun == [14])
    assert not keeping.done()
    file.go.set()
    await keeping
    assert file.read() == store.on_disk == 14
    await store.keep(12)
    assert file.begun == [14]


async def test_the_disk_gets_one_number_after_the_other(tmp_path: Path) -> None:
    """Also when whoever waited has gone: two writes at once could leave the older one there."""
    file = SlowFile(tmp_path)
    store = FenceStore(file)
    gone = asyncio.create_task(store.keep(14))
    await until("it writes", lambda: file.begun == [14])
    gone.cancel()
    await asyncio.gather(gone, return_exceptions=True)
    keeping = [asyncio.create_task(store.keep(fence)) for fence in (15, 16, 15)]
    # A second write would have begun by the time that another thread has.
    await asyncio.sleep(0)
    await asyncio.to_thread(lambda: None)
    assert file.begun == [14]
    file.go.set()
    await asyncio.gather(*keeping)
    assert file.begun == [14, 16]
    assert file.read() == 16


async def test_a_disk_that_fails_keeps_nobody_waiting_and_may_work_again(tmp_path, caplog):
    caplog.set_level(logging.ERROR)
    store = FenceStore(FenceFile(tmp_path / "gone"))
    with pytest.raises(StateUnusableError, match=r"cannot write .*fence\.json"):
        await store.keep(14)
    assert store.on_disk == 0
    assert "nobody can drive with lease 14" in caplog.text
    (tmp_path / "gone").mkdir()
    await store.keep(14)
    assert FenceFile(tmp_path / "gone").read() == 14


async def test_a_number_that_is_noted_is_written_without_anybody_waiting(tmp_path: Path) -> None:
    store = FenceStore(FenceFile(tmp_path))
    store.note(14)
    store.note(3)
    await until("it is written", lambda: store.on_disk == 14)
    assert FenceFile(tmp_path).read() == 14
