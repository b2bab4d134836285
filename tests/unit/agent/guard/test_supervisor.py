"""The guard as the agent sees and supervises it, with fake guard processes."""

import asyncio
import os
import resource
import signal
from contextlib import suppress
from pathlib import Path

import pytest
from fake_cloud import echo, eventually
from fake_guard import births, fake_guard_command, heard
from openssh_server import is_alive
from robotether_agent.fields import FieldError
from robotether_agent.guard.child_process import TICK_S, GuardProcess, SilenceDetector
from robotether_agent.guard.fork_server import START_S, ForkServer
from robotether_agent.guard.supervisor import (
    MAX_PAUSE_S,
    MAX_UNSENT_LINES,
    GuardSupervisor,
    pause_before,
)
from robotether_agent.own_programs import program_environment
from robotether_agent.problems import GuardDownError
from robotether_agent.tunnel import liveness


@pytest.fixture
async def start(place):
    started = []
    servers = []

    async def start_guard(mode):
        servers.append(ForkServer.start(fake_guard_command(place, mode)))
        started.append(await GuardProcess.start(servers[-1]))
        return started[-1]

    yield start_guard
    for guard in started:
        await guard.kill()
    for server in servers:
        server.close()


async def served(guard, lines=None):
    taken = [] if lines is None else lines
    with pytest.raises(GuardDownError) as caught:
        await asyncio.wait_for(guard.serve(lambda line: taken.append(dict(line))), 60)
    return caught.value.message


async def test_ticks_and_hands_lines_on(start, place):
    guard, lines = await start("serves"), []
    serving = asyncio.ensure_future(served(guard, lines))
    guard.send({"type": "stop", "id": "5f0c", "by": "ben"})
    await eventually(
        lambda: any(line.get("answers") == "5f0c" for line in lines), lambda: f"an answer: {lines}"
    )
    assert lines[0] == {"type": "ready", "port": births(place)[0]["port"]}
    text = (place / "heard.jsonl").read_text()
    await eventually(
        lambda: (place / "heard.jsonl").read_text().count('"tick"') > text.count('"tick"') + 2,
        lambda: "more ticks",
    )
    os.kill(guard.pid, signal.SIGKILL)
    assert await serving == "the guard was ended by SIGKILL"


@pytest.mark.parametrize(
    ("mode", "why"),
    [
        ("dies", "ended with status 1"),
        ("hangs", "the guard hangs"),
        ("rubbish", "an invalid line"),
    ],
)
async def test_what_is_wrong_with_a_guard_is_told(start, mode, why):
    assert why in await served(await start(mode))


async def test_a_guard_that_reads_nothing_is_killed(start):
    guard = await start("deaf")
    serving = asyncio.ensure_future(served(guard))
    while not serving.done():
        guard.send({"type": "lease", "fence": 1, "held": True, "pad": "x" * 10_000})
        await asyncio.sleep(0)
    assert await serving == "the guard was ended by SIGKILL"


async def test_frames_alone_never_kill_a_guard(start):
    """What waits behind them would: a guard that is late misses some, and they are unknown to it."""
    guard = await start("deaf")
    serving = asyncio.ensure_future(served(guard))
    for _ in range(2000):
        guard.offer({"type": "frame", "pad": "x" * 1000})
        await asyncio.sleep(0)
    assert not serving.done()
    os.kill(guard.pid, signal.SIGTERM)
    assert await serving == "the guard was ended by SIGTERM"


async def test_a_guard_that_has_just_begun_can_be_ended(place):
    """A signal that comes before its process has set itself up is not lost."""
    server = ForkServer.start(fake_guard_command(place, "serves"))
    await server.check()
    for _ in range(20):
        guard = await GuardProcess.start(server)
        os.kill(guard.pid, signal.SIGTERM)
        assert await served(guard) == "the guard was ended by SIGTERM"
        await guard.kill()
    server.close()


async def test_one_that_does_not_end_is_killed(start, place, monkeypatch):
    monkeypatch.setattr("robotether_agent.guard.child_process.EXIT_S", 0.2)
    guard = await start("stays")
    await eventually(lambda: bool(births(place)), lambda: "it runs")
    await asyncio.wait_for(guard.end(), 5)
    await eventually(lambda: not is_alive(guard.pid), lambda: "it is killed")


async def test_a_guard_that_does_not_end_keeps_no_other_waiting(start):
    guard = await start("serves")
    exit_code = guard._exit_code()
    await guard._server.check()
    os.kill(guard.pid, signal.SIGKILL)
    assert await exit_code == -signal.SIGKILL


async def test_a_guard_that_cannot_be_started_is_down(place):
    with pytest.raises(GuardDownError, match="cannot start the guard: No such file"):
        ForkServer.start([str(place / "none")])


def test_time_in_which_the_agent_stood_still_is_no_silence():
    """After a suspension the guard gets the time to be heard, and no more than that."""
    hearing = SilenceDetector(0.0)
    hearing.on_line(0.1)
    assert not hearing.is_lost(0.2)
    assert not hearing.is_lost(30.0)
    assert not hearing.is_lost(30.2)
    assert not hearing.is_lost(30.4)
    assert hearing.is_lost(30.7)


def test_a_start_may_take_longer_than_a_silence():
    """A small computer that boots loads Python for seconds; for ever it does not."""
    hearing, now = SilenceDetector(0.0), 0.0
    while not hearing.is_lost(now):
        now += TICK_S
    assert START_S < now < START_S + 1


def test_the_guard_gets_no_secret():
    """Settings of the agent, its join token among them, and systemd's socket stay with the agent."""
    given = {"PATH": "/bin", "ROBOTETHER_TOKEN": "rj_x", "NOTIFY_SOCKET": "/run/x", "LANG": "C"}
    passed_on = program_environment(given)
    assert {**passed_on, "PYTHONPATH": ""} == {"PATH": "/bin", "LANG": "C", "PYTHONPATH": ""}


def test_the_guard_is_the_one_that_came_with_the_agent():
    places = program_environment({"PYTHONPATH": "/opt/more"})["PYTHONPATH"].split(":")
    assert Path(places[0], "robotether_agent", "guard", "__main__.py").is_file()
    assert Path(places[-2], "robotether_common").is_dir()
    assert places[-1] == "/opt/more"


async def test_a_stop_outlives_the_agent(cloud, start_agent):
    """A robot that somebody stopped is still stopped after its next boot, and says so to the server."""
    agent = start_agent(cloud, guard="on")
    link = await cloud.link("session")
    link.send({"type": "stop", "id": "5f0c", "by": "ben"})
    await agent.until(lambda status: status.stopped_by == "ben", "stopped")
    await agent.stop()
    agent = start_agent(cloud, guard="on")
    link = await cloud.link("session", number=2)
    await eventually(lambda: bool(link.of_type("guard")), lambda: f"{link.received}")
    assert link.of_type("guard")[0]["stopped"]
    await agent.until(lambda status: status.stopped_by == "ben", "still stopped")


async def test_another_network_ends_no_drive(cloud, start_agent, monkeypatch):
    """The robot leaves a connection that works for the new network's once nobody drives."""
    agent = start_agent(cloud, guard="on")
    link = await cloud.link("session")
    link.send({"type": "lease", "fence": 1, "held": True})
    await agent.until_connected()
    monkeypatch.setattr(liveness, "path_of", lambda _: liveness.Path.MOVED)
    pings = len(link.of_type("ping"))
    await eventually(lambda: len(link.of_type("ping")) > pings + 2, lambda: f"{link.received}")
    link.send({"type": "lease", "fence": 1, "held": False})
    await cloud.link("session", number=2)


async def test_without_a_guard_the_forward_is_bare(cloud, start_agent, caplog):
    """The port leads straight to rosbridge, and log, status and server say so."""
    agent = start_agent(cloud, guard="off")
    status = await agent.until_connected()
    assert await echo(cloud.ports[0], "x", key="") == "x"
    assert status.guard == "off"
    assert (await cloud.link("session")).of_type("hello")[0]["guard"] == "off"
    assert "nothing stops this robot" in caplog.text


WANTS = {"key": "k" * 20, "deadman_ms": 500}
URL = "ws://127.0.0.1:9090"


class RunningSupervisor:
    def __init__(self, place, modes):
        self.views = []
        command = fake_guard_command(place, *modes)
        self.supervisor = GuardSupervisor(URL, command, on_change=self.views.append)
        self.task = asyncio.ensure_future(self.supervisor.run())
        self._place = place

    async def ready(self, count=1):
        def is_ready():
            born = births(self._place)
            return len(born) >= count and self.supervisor.view.port == born[-1]["port"]

        await eventually(is_ready, lambda: f"guard {count}: {self.supervisor.view}")

    async def is_stopped(self, expected=True):
        view = self.supervisor
        await eventually(lambda: view.view.stopped is expected, lambda: f"{view.view}")

    async def hears(self, *kinds):
        """Wait until the newest guard has heard these kinds, and return them, each one's last."""

        def of_the_newest():
            lines = heard(self._place)
            start = max((at for at, line in enumerate(lines) if line["type"] == "born"), default=0)
            return {line["type"]: line for line in lines[start:]}

        await eventually(
            lambda: set(kinds) <= set(of_the_newest()), lambda: f"{kinds} in {heard(self._place)}"
        )
        return [of_the_newest()[kind] for kind in kinds]

    async def stop(self):
        self.task.cancel()
        with suppress(asyncio.CancelledError):
            await self.task


@pytest.fixture
async def keep(place):
    made = []

    def start(*modes):
        made.append(RunningSupervisor(place, modes))
        return made[-1]

    yield start
    for running in made:
        await running.stop()


@pytest.fixture
async def running(keep):
    made = keep("serves")
    await made.ready()
    return made


async def test_frames_reach_the_guard_and_its_ages_the_session(keep, place):
    """An age is reported once: a later session gets the state alone."""
    running = keep("serves")
    running.supervisor.on_frame_sent("/early", 1, 0.5)
    await running.ready()
    with running.supervisor.following() as lines:
        running.supervisor.on_frame_sent("/a", 41, 12.3456)
        (frame,) = await running.hears("frame")
        assert frame == {"type": "frame", "camera": "/a", "frame": 41, "taken_ms": 12345.6}
        while (line := await asyncio.wait_for(lines.get(), 10))["type"] != "seen":
            pass
        assert line == {"type": "seen", "fence": 13, "ages_ms": [140.0]}
    with running.supervisor.following() as lines:
        assert [lines.get_nowait()["type"] for _ in range(lines.qsize())] == ["guard"]


@pytest.mark.parametrize("harm", [signal.SIGKILL, signal.SIGSTOP])
async def test_a_fork_server_that_fails_is_replaced(keep, place, monkeypatch, harm):
    """Its guard stays, also while another one starts, and the next guard is the other one's."""
    monkeypatch.setattr("robotether_agent.guard.supervisor.FORK_SERVER_CHECK_S", 0.05)
    running = keep("serves")
    await running.ready()
    first = running.supervisor._fork_server
    os.kill(first.pid, harm)
    await eventually(
        lambda: running.supervisor._fork_server not in {None, first}, lambda: "another one"
    )
    await eventually(lambda: not is_alive(first.pid), lambda: "the first one is gone")
    assert {view.state for view in running.views} == {"ready"}
    second = running.supervisor._fork_server.pid
    os.kill(births(place)[0]["pid"], signal.SIGKILL)
    await running.ready(2)
    assert births(place)[1]["parent"] == second
    assert births(place)[1]["frozen"]
    await running.stop()
    assert not any(is_alive(pid) for pid in (second, births(place)[1]["pid"]))


async def test_a_guard_is_followed_once_there_are_file_descriptors(keep, place):
    running = keep("serves")
    await running.ready()
    (first,) = births(place)
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, hard))
    try:
        os.kill(first["pid"], signal.SIGKILL)
        await eventually(
            lambda: "Too many open files" in running.supervisor.view.detail,
            lambda: f"{running.supervisor.view}",
        )
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    await running.ready(2)
    assert births(place)[1]["parent"] == first["parent"]


@pytest.mark.parametrize("harm", [signal.SIGKILL, signal.SIGSTOP])
async def test_a_guard_is_followed_without_a_fork_server(keep, place, monkeypatch, harm):
    """Both may fail at once; then Python has to start for the next guard."""
    running = keep("serves")
    await running.ready()
    running.supervisor.on_config(WANTS, direct=False)
    os.kill(running.supervisor._fork_server.pid, harm)
    guard = births(place)[0]["pid"]
    os.kill(guard, harm)
    await running.ready(2)
    assert (await running.hears("config"))[0]["guard"] == WANTS
    assert not is_alive(guard)


@pytest.mark.parametrize("with_fork_server", [True, False])
async def test_ends_only_after_the_guard(running, place, with_fork_server):
    """The guard is asked to stop the robot, and has the time for it."""
    if not with_fork_server:
        os.kill(running.supervisor._fork_server.pid, signal.SIGKILL)
    await running.stop()
    assert heard(place)[-1]["type"] == "exit"
    # Its output ends a moment before the kernel calls it a zombie.
    await eventually(lambda: not is_alive(births(place)[0]["pid"]), lambda: "it has ended")


async def test_a_stop_that_its_guard_did_not_answer_is_told_to_the_next(keep, place):
    """A guard that dies of the stop itself leaves a stopped robot."""
    running = keep("crashes", "serves")
    await running.ready()
    running.supervisor.on_config(WANTS, direct=False)
    running.supervisor.on_stop("5f0c", "ben")
    await running.ready(2)
    await running.is_stopped()
    os.kill(births(place)[1]["pid"], signal.SIGKILL)
    await running.ready(3)
    # The third guard may know it from its own file.
    await eventually(
        lambda: stops_sent(place) == ["5f0c", "5f0c", "kept"], lambda: f"{stops_sent(place)}"
    )


async def test_a_stop_that_the_disk_did_not_take_outlives_its_guard(keep, place):
    """The next guard finds no stop, and is told of it; a release is for the guard that has it."""
    running = keep("serves")
    running.supervisor.on_config(WANTS, direct=False)
    await running.ready()
    running.supervisor.on_stop("5f0c", "ben")
    await running.is_stopped()
    with running.supervisor.following() as lines:
        os.kill(births(place)[0]["pid"], signal.SIGKILL)
        await running.ready(2)
        # A release before the answer is refused.
        while (await asyncio.wait_for(lines.get(), 10))["answers"] != "kept":
            pass
    assert stops_sent(place) == ["5f0c", "kept"]
    assert running.supervisor.view.stopped
    running.supervisor.on_release("77aa", "ann")
    await running.is_stopped(False)


def stops_sent(place):
    return [line["id"] for line in heard(place) if line["type"] == "stop"]


async def test_a_release_never_comes_late(keep, place):
    """What a guard that is down cannot do is not done later, when nobody expects it any more."""
    running = keep("dies", "dies", "dies", "serves")
    running.supervisor.on_config(WANTS, direct=False)
    running.supervisor.on_stop("5f0c", "ben")
    running.supervisor.on_release("77aa", "ann")
    await running.ready(4)
    await running.is_stopped()
    assert not [line for line in heard(place) if line["type"] == "release"]


def test_pauses_grow_to_a_bound():
    assert [pause_before(restart) for restart in (1, 2, 3, 4)] == [0.0, 0.1, 0.2, 0.4]
    assert pause_before(1_000_000) == MAX_PAUSE_S


async def test_a_session_hears_how_it_is_and_each_answer(running, place):
    with running.supervisor.following() as lines:
        first = await lines.get()
        assert (first["state"], first["stopped"], first["answers"]) == ("ready", False, None)
        running.supervisor.on_stop("5f0c", "ben")
        answer = await asyncio.wait_for(lines.get(), 5)
        while answer["answers"] is None:
            answer = await asyncio.wait_for(lines.get(), 5)
        assert (answer["answers"], answer["stopped"], answer["by"]) == ("5f0c", True, "ben")
        os.kill(births(place)[0]["pid"], signal.SIGKILL)
        gone = await asyncio.wait_for(lines.get(), 5)
        assert (gone["state"], gone["stopped"], gone["answers"]) == ("down", True, None)
        assert set(gone) == {"type", "state", "stopped", "by", "moving", "answers", "refused"}
    await running.ready(2)


async def test_a_session_that_takes_nothing_costs_no_memory(running, place):
    """What a session does not send is bounded, and the newest line stays."""
    with running.supervisor.following() as lines:
        for number in range(MAX_UNSENT_LINES + 5):
            running.supervisor.on_stop(f"s{number}", "ben")
        last = f"s{MAX_UNSENT_LINES + 4}"

        def newest():
            return any(line["answers"] == last for line in lines._queue)

        await eventually(newest, lambda: f"{lines}")
        assert lines.qsize() <= MAX_UNSENT_LINES


async def test_what_the_guard_would_not_take_changes_nothing(running, place):
    """A configuration that is wrong ends the session that brought it, and the guard keeps the last good one."""
    running.supervisor.on_config(WANTS, direct=False)
    with pytest.raises(FieldError, match="deadman_ms"):
        running.supervisor.on_config({**WANTS, "deadman_ms": 0}, direct=True)
    os.kill(births(place)[0]["pid"], signal.SIGKILL)
    await running.ready(2)
    assert (await running.hears("config"))[0]["guard"] == WANTS
