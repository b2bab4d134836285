"""How a fleet is divided among processes, and that such a process leaves nothing behind."""

from __future__ import annotations

import asyncio
from pathlib import Path
from types import SimpleNamespace

import pytest
from local_network import free_port
from openssh_server import descendants, is_alive, kill
from paper.fleet import Worker, WorkerFailedError, shares, watched_s, workers

WAIT_S = 40
# Enough of an uplink: the worker runs where the test does.
HERE = SimpleNamespace(inside=SimpleNamespace(command=lambda *words: list(words)))


@pytest.mark.parametrize(
    ("count", "wanted"), [(1, [1]), (10, [5, 5]), (50, [25, 25]), (51, [26, 25]), (150, [50] * 3)]
)
def test_shares(count, wanted):
    """At least two processes, none with more than 50 robots."""
    assert shares(count) == wanted


def test_large_fleets_are_watched_longer():
    """A small one as long as a robot may take."""
    assert watched_s(50) == 60
    assert watched_s(1000) > 200


def robots(folder: Path, count: int) -> list[SimpleNamespace]:
    """Robots whose server is not there."""
    server = f"127.0.0.1:{free_port()}"
    made = []
    for number in range(count):
        settings = {
            "server": server,
            "mac": f"02:00:00:00:62:{number:02x}",
            "allow_local_mac": "true",
            "state_dir": str(folder / f"state{number}"),
        }
        made.append(SimpleNamespace(name=f"x-{number}", settings=settings))
    return made


async def test_a_worker_starts_and_ends_robots_and_leaves_nothing(tmp_path):
    """Also without a server; they can be started again."""
    async with asyncio.timeout(WAIT_S):
        async with workers(robots(tmp_path, 4), [HERE, HERE], tmp_path) as sides:
            pids = [pid for side in sides for pid in side.pids]
            for order in ("start", "end", "start"):
                await asyncio.gather(*(side.do(order, WAIT_S) for side in sides))
        assert not [pid for pid in pids if is_alive(pid) or descendants(pid)]


async def test_what_an_agent_cannot_use_is_told(tmp_path):
    """The robot has failed, and the others go on."""
    heard: list[dict[str, str]] = []
    broken = SimpleNamespace(name="broken", settings={"server": "no host"})
    async with asyncio.timeout(WAIT_S):
        async with workers([broken, *robots(tmp_path, 1)], [HERE, HERE], tmp_path) as sides:
            for side in sides:
                side.heard = heard.append
                await side.do("start", WAIT_S)
    [message] = heard
    assert message["robot"] == "broken"
    assert "no host" in message["failed"]


async def test_a_worker_that_is_gone_is_not_waited_for(tmp_path):
    """Whoever gives it an order hears so at once."""
    with (tmp_path / "log").open("ab") as log:
        async with asyncio.timeout(WAIT_S):
            worker = await Worker.start(HERE, robots(tmp_path, 1), log)
            kill(worker.pids[0])
            with pytest.raises(WorkerFailedError, match="a worker failed, it ended"):
                await worker.has_done("open", 10 * WAIT_S)
            await worker.end()
