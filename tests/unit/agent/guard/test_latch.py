"""The stop in memory and on the disk."""

from __future__ import annotations

import asyncio
import tempfile
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from robotether_agent.guard.agent_messages import ReleaseRequest, StopRequest
from robotether_agent.guard.latch import MAX_WAITING, Latch, StopFile
from sim_client import until


@pytest.mark.parametrize("data", [b"", b"{", b"[]", b"{}", b'{"by": 3}', b"\xff", None])
def test_a_stop_that_cannot_be_read_is_a_stop(tmp_path: Path, data: bytes | None) -> None:
    file = tmp_path / "stop.json"
    file.mkdir() if data is None else file.write_bytes(data)
    assert StopFile(tmp_path).read() == ""


class SlowFile(StopFile):
    def __init__(self, state_dir: Path) -> None:
        super().__init__(state_dir)
        self.go = threading.Event()
        self.go.set()
        self.written = list[str]()

    def write(self, by: str) -> None:
        assert self.go.wait(5)
        self.written.append(by)
        super().write(by)

    def remove(self) -> None:
        assert self.go.wait(5)
        super().remove()


@asynccontextmanager
async def running(
    file: StopFile, answers: list[str], reports: list[str | None] | None = None
) -> AsyncIterator[Latch]:
    """A latch whose task runs; `told` gets whose stop is told with each answer."""

    def answer(order_id: str) -> None:
        answers.append(order_id)
        if reports is not None:
            reports.append(latch.reported_by)

    latch = Latch(file, lambda: None, answer)
    task = asyncio.create_task(latch.run())
    yield latch
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


async def test_a_stop_counts_before_the_disk_has_it_and_is_answered_after(tmp_path: Path) -> None:
    file, answers = SlowFile(tmp_path), list[str]()
    async with running(file, answers) as latch:
        file.go.clear()
        latch.handle(StopRequest("5f", "ben"))
        assert (latch.stopped, latch.by) == (True, "ben")
        await asyncio.sleep(0)
        assert answers == []
        assert latch.reported_by is None
        file.go.set()
        await latch.settled()
        assert (answers, latch.reported_by) == (["5f"], "ben")
        assert file.read() == "ben"


async def test_a_release_counts_when_the_disk_has_it(tmp_path: Path) -> None:
    file, answers = SlowFile(tmp_path), list[str]()
    file.write("ben")
    async with running(file, answers) as latch:
        assert (latch.stopped, latch.by) == (True, "ben")
        file.go.clear()
        latch.handle(ReleaseRequest("77", "ann"))
        assert (latch.stopped, latch.reported_by) == (True, "ben")
        file.go.set()
        await latch.settled()
        assert (latch.stopped, latch.reported_by) == (False, None)
        assert file.read() is None


async def test_a_stop_during_a_release_wins(tmp_path: Path) -> None:
    """In memory at once, and on the disk in the end; no answer on the way says that the robot is released."""
    file, answers, reports = SlowFile(tmp_path), list[str](), list[str | None]()
    async with running(file, answers, reports) as latch:
        latch.handle(StopRequest("1", "ben"))
        await latch.settled()
        file.go.clear()
        latch.handle(ReleaseRequest("2", "ann"))
        await asyncio.sleep(0)
        latch.handle(StopRequest("3", "eve"))
        file.go.set()
        await latch.settled()
        assert (latch.stopped, latch.by, file.read()) == (True, "eve", "eve")
        assert answers == ["1", "2", "3"]
        assert reports == ["ben", "ben", "eve"]


async def test_repeats_of_a_stop_do_not_pile_up_before_a_disk_that_hangs(tmp_path: Path) -> None:
    """The newest is written and answered, for which the agent waits; those that it overtook are not."""
    file, answers = SlowFile(tmp_path), list[str]()
    async with running(file, answers) as latch:
        file.go.clear()
        latch.handle(StopRequest("first", "ben"))
        await asyncio.sleep(0)
        for number in range(1000):
            latch.handle(StopRequest(str(number), f"p{number}"))
        assert (latch.stopped, latch.by) == (True, "p999")
        file.go.set()
        await latch.settled()
        assert (file.written, file.read()) == (["ben", "p999"], "p999")
        assert (answers, latch.reported_by) == (["first", "999"], "p999")


async def test_what_waits_for_a_disk_is_bounded(tmp_path: Path) -> None:
    """That holds whatever the messages; releases are dropped first, so that the robot stays stopped."""
    file, answers = SlowFile(tmp_path), list[str]()
    async with running(file, answers) as latch:
        file.go.clear()
        for number in range(10 * MAX_WAITING):
            latch.handle(StopRequest(f"s{number}", "ben"))
            latch.handle(ReleaseRequest(f"r{number}", "ann"))
        file.go.set()
        await latch.settled()
        assert len(answers) <= MAX_WAITING + 1
        assert (latch.stopped, file.read()) == (True, "ben")


STEPS = st.lists(
    st.sampled_from(["stop by ben", "stop by eve", "release", "disk hangs", "disk works", "wait"]),
    max_size=30,
)


@given(STEPS)
def test_disk_and_memory_end_as_the_last_order_says(steps: list[str]) -> None:
    """However the disk hangs and comes back meanwhile; each release and the newest stop are answered."""

    async def scenario(file: SlowFile) -> None:
        last: str | None = None
        answers = list[str]()
        async with running(file, answers) as latch:
            for number, step in enumerate(steps):
                if step.startswith("stop"):
                    last = step.removeprefix("stop by ")
                    latch.handle(StopRequest(str(number), last))
                    assert (latch.stopped, latch.by) == (True, last)
                elif step == "release":
                    last = None
                    latch.handle(ReleaseRequest(str(number), "ann"))
                elif step == "wait":
                    await asyncio.sleep(0.001)
                else:
                    (file.go.set if step == "disk works" else file.go.clear)()
            file.go.set()
            await latch.settled()
            assert (file.read(), latch.reported_by) == (last, last)
            assert (latch.stopped, latch.by) == (last is not None, last or "")
        releases = [str(number) for number, step in enumerate(steps) if step == "release"]
        stops = [str(number) for number, step in enumerate(steps) if step.startswith("stop")]
        assert answers == sorted(answers, key=int)
        assert set(answers) >= {*releases, *stops[-1:]}

    with tempfile.TemporaryDirectory() as place:
        asyncio.run(scenario(SlowFile(Path(place))))


async def test_a_disk_that_fails_leaves_the_robot_stopped(tmp_path: Path) -> None:
    answers = list[str]()
    (tmp_path / "stop.json").mkdir()
    async with running(StopFile(tmp_path), answers) as latch:
        assert latch.stopped
        latch.handle(ReleaseRequest("77", "ann"))
        await until("it answers", lambda: answers == ["77"])
        assert latch.stopped


async def test_a_stop_that_no_disk_takes_is_told_and_logged(tmp_path, caplog):
    answers = list[str]()
    async with running(StopFile(tmp_path / "gone"), answers) as latch:
        latch.handle(StopRequest("5f", "ben"))
        await until("it answers", lambda: answers == ["5f"])
        assert (latch.stopped, latch.reported_by) == (True, "ben")
    assert "stop.json" in caplog.text
    assert "loss of power" in caplog.text
