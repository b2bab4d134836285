"""What the guard keeps on the disk: the stop, the newest number of a lease, and the motion."""

import asyncio
import logging
import tempfile
import threading
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from robotether_agent.guard.agent_messages import ReleaseRequest, StopRequest
from robotether_agent.guard.fences import FenceFile, FenceStore
from robotether_agent.guard.latch import MAX_WAITING, Latch, StopFile
from robotether_agent.guard.topics import REMOVED_AFTER_S, Driven, MotionFile
from robotether_agent.problems import StateUnusableError
from sim_client import until


@pytest.mark.parametrize("data", [b"", b"{", b"[]", b"{}", b'{"by": 3}', b"\xff", None])
def test_a_stop_that_cannot_be_read_is_a_stop(tmp_path, data):
    file = tmp_path / "stop.json"
    file.mkdir() if data is None else file.write_bytes(data)
    assert StopFile(tmp_path).read() == ""


class SlowStopFile(StopFile):
    """Waits in a write until the disk may `go` on; `begun` keeps what came to it."""

    def __init__(self, state_dir):
        super().__init__(state_dir)
        self.go = threading.Event()
        self.go.set()
        self.begun = list[str]()

    def write(self, by):
        self.begun.append(by)
        assert self.go.wait(5)
        super().write(by)

    def remove(self):
        assert self.go.wait(5)
        super().remove()


@asynccontextmanager
async def running(file, answers, reports=None):
    """A latch whose task runs; `told` gets whose stop is told with each answer."""

    def answer(order_id):
        answers.append(order_id)
        if reports is not None:
            reports.append(latch.reported_by)

    latch = Latch(file, lambda: None, answer)
    task = asyncio.create_task(latch.run())
    yield latch
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


async def test_a_stop_counts_before_the_disk_has_it_and_is_answered_after(tmp_path):
    file, answers = SlowStopFile(tmp_path), list[str]()
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


async def test_a_release_counts_when_the_disk_has_it(tmp_path):
    file, answers = SlowStopFile(tmp_path), list[str]()
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


async def test_a_stop_during_a_release_wins(tmp_path):
    """In memory at once, and on the disk in the end; no answer on the way says that the robot is released."""
    file, answers, reports = SlowStopFile(tmp_path), list[str](), list[str | None]()
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


async def test_repeats_of_a_stop_do_not_pile_up_before_a_disk_that_hangs(tmp_path):
    """The newest is written and answered, for which the agent waits; those that it overtook are not."""
    file, answers = SlowStopFile(tmp_path), list[str]()
    async with running(file, answers) as latch:
        file.go.clear()
        latch.handle(StopRequest("first", "ben"))
        await asyncio.sleep(0)
        for number in range(1000):
            latch.handle(StopRequest(str(number), f"p{number}"))
        assert (latch.stopped, latch.by) == (True, "p999")
        file.go.set()
        await latch.settled()
        assert (file.begun, file.read()) == (["ben", "p999"], "p999")
        assert (answers, latch.reported_by) == (["first", "999"], "p999")


async def test_what_waits_for_a_disk_is_bounded(tmp_path):
    """That holds whatever the messages; releases are dropped first, so that the robot stays stopped."""
    file, answers = SlowStopFile(tmp_path), list[str]()
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
def test_disk_and_memory_end_as_the_last_order_says(steps):
    """However the disk hangs and comes back meanwhile; each release and the newest stop are answered."""

    async def scenario(file):
        last = None
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
        asyncio.run(scenario(SlowStopFile(Path(place))))


async def test_a_disk_that_fails_leaves_the_robot_stopped(tmp_path):
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


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"fence": "3"}', '{"fence": -1}', "\udcff"])
def test_a_number_that_cannot_be_read_is_none(tmp_path, text, caplog):
    (tmp_path / "fence.json").write_bytes(text.encode(errors="surrogateescape"))
    assert FenceFile(tmp_path).read() == 0
    assert "so the server's number counts" in caplog.text
    FenceFile(tmp_path).write(3)
    assert FenceFile(tmp_path).read() == 3


class SlowFenceFile(FenceFile):
    def __init__(self, state_dir):
        super().__init__(state_dir)
        self.go = threading.Event()
        self.begun = list[int]()

    def write(self, fence):
        self.begun.append(fence)
        assert self.go.wait(5)
        super().write(fence)


async def test_a_newer_number_waits_for_the_disk_and_an_older_one_does_not(tmp_path):
    FenceFile(tmp_path).write(13)
    file = SlowFenceFile(tmp_path)
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


async def test_the_disk_gets_one_number_after_the_other(tmp_path):
    """Two writes at once could leave the older one there, even after whoever waited has gone."""
    file = SlowFenceFile(tmp_path)
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


async def test_a_number_that_is_noted_is_written_without_anybody_waiting(tmp_path):
    store = FenceStore(FenceFile(tmp_path))
    store.note(14)
    store.note(3)
    await until("it is written", lambda: store.on_disk == 14)
    assert FenceFile(tmp_path).read() == 14


A = Driven("/a", "ackermann", "ackermann_msgs/AckermannDriveStamped", "base")
B = Driven("/b", "unknown")


@pytest.mark.parametrize(
    "text",
    [
        "", "[]", '{"topics": 3}', '{"topics": [3]}', '{"topics": [{"topic": "~x", "shape": "twist", "type": ""}]}',
        '{"topics": [{"topic": "/x", "shape": "rocket", "type": ""}]}',
        '{"topics": [{"topic": "/x", "shape": "twist", "type": "std_msgs/String"}]}',
    ],
)  # fmt: skip
def test_motion_that_cannot_be_read_is_motion(tmp_path, text):
    (tmp_path / "motion.json").write_text(text)
    assert MotionFile(tmp_path).read() == []


def test_the_motion_file_says_how_each_topic_is_driven_now(tmp_path):
    """It does so after a change of type, too; of topics that were forgotten it says nothing."""
    file = MotionFile(tmp_path)
    file.ensure(A, ["/a"])
    file.ensure(B, ["/a", "/b"])
    assert file.read() == [A, B]
    stamped = Driven("/a", "twist_stamped", frame_id="base")
    file.ensure(stamped, ["/a", "/b"])
    assert file.read() == [stamped, B]
    file.ensure(A, ["/a"])
    assert file.read() == [A]
    file.ensure(B, ["/a", "/b"])
    assert file.read() == [A, B]


def test_the_motion_file_goes_when_the_robot_has_stood_for_a_while(tmp_path):
    file = MotionFile(tmp_path)
    file.ensure(A, ["/a"])
    file.tend(5.0, moves=True)
    file.tend(5.0 + REMOVED_AFTER_S / 2, moves=False)
    assert file.read() == [A]
    assert file.ends_at == 5.0 + REMOVED_AFTER_S
    file.tend(5.0 + REMOVED_AFTER_S, moves=False)
    assert file.read() is None
    assert file.ends_at is None


def test_another_guards_motion_file_stays(tmp_path):
    """Until it is taken over: a guard that has not read its settings yet ends while another one drives."""
    MotionFile(tmp_path).ensure(A, ["/a"])
    file = MotionFile(tmp_path)
    file.end(1.0)
    assert file.read() == [A]
    file.adopt([A])
    file.end(1.0)
    assert file.read() is None


def test_a_motion_file_that_cannot_be_removed_stays_for_now(tmp_path):
    file = MotionFile(tmp_path)
    file.ensure(A, ["/a"])
    (tmp_path / "motion.json").unlink()
    (tmp_path / "motion.json").mkdir()
    file.end(1.0)
    assert file.ends_at == 1.0 + REMOVED_AFTER_S
