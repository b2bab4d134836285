"""Which requests go to another cell, as its nginx would be asked."""

import time
from itertools import product

import pytest
from fake_robot import HOST
from relay_server import ANN, until
from robotether_server.relay.cells.keys import PROOF_HEADER


@pytest.fixture
def ann(memory_database, cell_a, cell_b):
    headers = memory_database.bearer(ANN)
    for database in (cell_a.database, cell_b.database):
        database.credentials.update(memory_database.credentials)
    return headers


async def test_nginx_is_sent_to_the_robots_cell(*, at_b, cell_a, cell_b, http, ann, peer_keys):
    """What ann may do there is the other cell's part; a stop begins here if that one is away."""
    cell_of_robot = f"{HOST}:{cell_b.listener.port}"
    for method, path, location in (
        ("GET", "/robots/sim1/ros", "@cell"),
        ("GET", "/robots/sim1/video/frames", "@cell"),
        ("GET", "/robots/sim1/video/stream?topic=/a", "@cell"),
        ("GET", "/api/v1/robots/sim1/control", "@cell"),
        ("GET", "/api/v1/robots/sim1/uplink", "@cell"),
        ("GET", "/api/v1/robots/sim1/topics/a/%2Fb", "@cell"),
        ("POST", "/api/v1/robots/sim1/services/a", "@cell"),
        ("POST", "/api/v1/robots/sim1/lease", "@cell"),
        ("POST", "/api/v1/robots/sim1/release", "@cell"),
        ("POST", "/api/v1/robots/sim1/stop", "@cell_or_here"),
    ):
        async with http.request(method, cell_a.server.url + path, headers=ann) as answer:
            assert answer.status == 204
            assert answer.headers["X-Accel-Redirect"] == location
            assert answer.headers["X-Robotether-Cell"] == cell_of_robot
            assert "Content-Type" not in answer.headers
        async with http.request(method, cell_b.server.url + path, headers=ann) as answer:
            assert "X-Accel-Redirect" not in answer.headers
    async with http.get(f"{cell_a.server.inside_url}/cells") as answer:
        assert await answer.text() == f"{cell_of_robot}\n"
    # What another cell has forwarded goes no further.
    url = f"http://{HOST}:{cell_a.relay.peer_port}/api/v1/robots/sim1/control"
    async with http.get(url, headers={PROOF_HEADER: peer_keys.proof}) as answer:
        assert answer.status == 401


async def test_nothing_of_strangers_is_forwarded(at_b, cell_a, http):
    """Each would cost both cells a TLS handshake; this cell refuses it as the other one would."""
    for path, (query, headers) in product(
        ("/robots/sim1/ros", "/robots/sim1/video/snapshot", "/api/v1/robots/sim1/control"),
        (
            ("", {}),
            ("", {"Authorization": "Bearer rt_random"}),
            ("?ticket=e30.aaaaaa.random", {}),
            ("?ticket=x", {}),
        ),
    ):
        async with http.get(cell_a.server.url + path + query, headers=headers) as answer:
            assert "X-Accel-Redirect" not in answer.headers
            assert answer.status in {400, 401, 403, 426}


async def test_a_ticket_that_is_over_is_the_other_cells_to_refuse(
    *, at_b, cell_a, sim1, http, monkeypatch
):
    """The clocks of two machines differ; no stranger has such a ticket."""
    url = cell_a.server.ros_url(sim1)
    now = time.time()
    monkeypatch.setattr(time, "time", lambda: now + 60)
    async with http.get(url) as answer:
        assert answer.headers["X-Accel-Redirect"] == "@cell"


async def test_all_who_ask_are_forwarded_while_the_database_is_away(*, at_b, cell_a, http):
    """The other cell may know them, and can stop the robot."""
    cell_a.database.down = True
    headers = {"Authorization": "Bearer rt_new"}
    async with http.post(f"{cell_a.server.url}/api/v1/robots/sim1/stop", headers=headers) as answer:
        assert answer.headers["X-Accel-Redirect"] == "@cell_or_here"


async def test_stopping_all_stops_those_of_other_cells(
    *, at_b, cell_a, cell_b, sim1, http, memory_database
):
    for database in (memory_database, cell_a.database, cell_b.database):
        database.grants[1, sim1.id] = "manage"
    headers = memory_database.bearer(ANN)
    await until(
        lambda: cell_a.relay.fleet.state().level(1, sim1.id) == "manage", "a knows the right"
    )
    async with http.post(f"{cell_a.server.url}/api/v1/stop", headers=headers) as answer:
        assert await answer.json() == {
            "robots": [{"name": "sim1", "mac": sim1.mac, "stopped": True, "confirmed": True}],
            "cells_unreached": [],
        }
    assert at_b.session.stopped_by == "ann"
    await cell_b.relay.control.stops.release(sim1, "ann")
    async with cell_a.listener.cut():
        await until(lambda: cell_b.relay.peers.count() == 0, "b does not follow a")
        async with http.post(f"{cell_a.server.url}/api/v1/stop", headers=headers) as answer:
            assert await answer.json() == {
                "robots": [{"name": "sim1", "mac": sim1.mac, "stopped": True, "confirmed": False}],
                "cells_unreached": ["b"],
            }
        # Though its own cell does not show it yet.
        assert cell_a.shown(sim1).control.stopped.by == "ann"
    await until(lambda: at_b.session.stopped, "it is stopped when b follows a again")
