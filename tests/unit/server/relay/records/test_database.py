"""The relay's way to the database: what it does when that hangs, and the whole path with it."""

import asyncio
import datetime as dt
import threading
from contextlib import asynccontextmanager
from socket import create_server

import pytest
from aiohttp import ClientSession, TCPConnector
from fake_robot import FINGERPRINT, WAIT_S, FakeRobot
from granted import give
from relay_clients import closing
from relay_server import SESSION_KEY, running_relay, until
from robotether_server.db import Database, credentials, robots, users
from robotether_server.db.control import NewLease
from robotether_server.db.fleet import RelayUser
from robotether_server.identity import PublicKey
from robotether_server.problems import StoreUnavailableError
from robotether_server.relay.auth.credentials import credential_of
from robotether_server.relay.records import database as module
from robotether_server.relay.records.database import RelayDatabase
from robotether_server.settings.server import DatabaseSettings

PUBLISH = '{"op":"publish","topic":"/cmd_vel"}'
LOOK_UP = '{"op":"call_service","service":"/rosapi/topics"}'


@pytest.fixture
def ann(database):
    with database.transaction() as tx:
        robot_id = robots.add(tx, "00:1b:44:11:3a:b1", "sim1")
        robots.rotate_key(tx, robot_id, PublicKey("ssh-ed25519 AAAA", FINGERPRINT))
        robots.set_state(tx, robot_id, "active")
        # The longest that is allowed: the machine of a test may be busy.
        robots.set_settings(tx, robot_id, {"guard": {"max_age_ms": 2000}})
        ann_id = users.add(tx, "ann", "x", "user")
        give(tx, ann_id, robot_id, "drive")
    return RelayUser(ann_id, "ann")


def log_in(database):
    with database.transaction() as tx:
        text = credentials.create_login(
            tx, users.get(tx, "ann"), "192.0.2.1", dt.timedelta(hours=1)
        )
    return credential_of("login", text)


@asynccontextmanager
async def robot_of(relay, mode="guard_off"):
    # A database that was too slow for the first question answers one of the next.
    await until(lambda: "sim1" in relay.relay.fleet.state().by_name, "the relay knows sim1")
    sim1 = relay.relay.fleet.state().by_name["sim1"]
    robot = FakeRobot(sim1.id, SESSION_KEY, mode)
    await robot.start(relay.relay.session_port)
    await until(lambda: relay.relay.registry.presence(sim1.id).ros == "ok", "sim1 is well")
    try:
        yield robot
    finally:
        await robot.stop()


async def passes(socket):
    """A message goes to the robot and back, however long it takes: no command, which grows too old meanwhile."""
    await socket.send_str(LOOK_UP)
    async with asyncio.timeout(WAIT_S):
        assert await socket.receive_str() == LOOK_UP


async def test_nobody_waits_to_be_known_while_the_database_hangs():
    with create_server(("127.0.0.1", 0)) as silent:
        settings = DatabaseSettings("127.0.0.1", silent.getsockname()[1], "r", "relay", "x")
        relay_database = RelayDatabase(Database(settings), "main", answer_within_s=0.2)
        async with asyncio.timeout(5):
            asking = (relay_database.changes() for _ in range(100))
            answers = await asyncio.gather(*asking, return_exceptions=True)
        assert {type(answer) for answer in answers} == {StoreUnavailableError}
        assert {str(answer).partition(": ")[2].partition(";")[0] for answer in answers} == {
            "no answer in 0.2 s",
            "too many queries are waiting",
        }
        with pytest.raises(StoreUnavailableError, match="it hangs"):
            await relay_database.users_of([credential_of("login", "x")])
        relay_database.close()


async def stop(task):
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


async def test_strangers_take_no_place_of_the_relays_own_duties(
    *, mariadb, database, ann, http, monkeypatch
):
    """With 200 unknown tokens not answered yet, somebody stops, somebody drives, and a right ends."""
    login, (first_stop, observing) = log_in(database), tokens_of_ann(database)
    is_over, answer, questions = threading.Event(), module.fleet.users_of, []

    def answer_strangers_last(tx, asked):
        found = answer(tx, asked)
        if not found:
            questions.append(len(asked))
            is_over.wait(WAIT_S)
        return found

    monkeypatch.setattr(module.fleet, "users_of", answer_strangers_last)
    relay_database = RelayDatabase(Database(mariadb.settings("relay")), "main", WAIT_S * 2)
    async with (
        ClientSession(connector=TCPConnector(limit=0)) as others,
        running_relay(relay_database) as relay,
        robot_of(relay, "guarded") as robot,
    ):
        sim1 = relay.relay.fleet.state().by_name["sim1"]
        control = f"{relay.url}/api/v1/robots/sim1/control"
        strangers = asyncio.gather(
            *(status_of(others, control, f"unknown {n}", f"192.0.2.{n % 5}") for n in range(200))
        )
        await until(lambda: questions, "the strangers' first question is open")
        url = relay.ros_url(sim1, "drive", ann, login)
        try:
            async with asyncio.timeout(WAIT_S), http.ws_connect(url) as driver:
                await robot.connections(1)
                stopping = f"{relay.url}/api/v1/robots/sim1/stop"
                bearer = {"Authorization": f"Bearer {first_stop}"}
                async with http.post(stopping, headers=bearer) as answered:
                    assert (await answered.json())["stopped"]["by"] == "ann"
                assert (await closing(driver))[0] == 4003
            async with http.ws_connect(relay.ros_url(sim1, "observe", ann, observing)) as observer:
                with database.transaction() as tx:
                    tx.change("DELETE FROM grants")
                assert (await closing(observer))[0] == 4001
            assert len(questions) == 1
        finally:
            is_over.set()
        assert set(await strangers) <= {401, 429}


def tokens_of_ann(database):
    with database.transaction() as tx:
        ann = users.get(tx, "ann")
        texts = [credentials.create_token(tx, ann, name, None) for name in ("a", "b")]
    return texts[0], credential_of("token", texts[1])


async def status_of(http, url, token, address):
    headers = {"Authorization": f"Bearer {token}", "X-Forwarded-For": address}
    async with http.get(url, headers=headers) as answer:
        return answer.status


async def test_a_drive_begins_while_the_database_hangs(mariadb, database, ann, http):
    """The open one goes on until then; and the database has the new one's number once it answers."""
    login = log_in(database)
    memory_database = RelayDatabase(Database(mariadb.settings("relay")), "main", WAIT_S * 10)
    async with running_relay(memory_database) as relay, robot_of(relay, "guarded") as robot:
        sim1 = relay.relay.fleet.state().by_name["sim1"]
        async with http.ws_connect(relay.ros_url(sim1, "drive", ann, login)) as first:
            await robot.connections(1)
            mariadb.container.pause()
            try:
                await first.send_str(PUBLISH)
                assert '"fence":1}' in await first.receive_str(timeout=WAIT_S)
                async with http.ws_connect(relay.ros_url(sim1, "drive", ann, login)) as second:
                    handshakes = await robot.connections(2)
                    assert handshakes[1]["Robotether-Fence"] == "2"
                    assert (await closing(first))[0] == 4002
                    await passes(second)
            finally:
                mariadb.container.unpause()
        await relay.relay.event_writer.flush(30)
        assert fences_in(database) == (2, [1, 2])
    # The next relay goes on from there.
    memory_database = RelayDatabase(Database(mariadb.settings("relay")), "main")
    async with running_relay(memory_database) as relay, robot_of(relay, "guarded") as robot:
        async with http.ws_connect(relay.ros_url(sim1, "drive", ann, login)):
            await robot.connections(1)
        await relay.relay.event_writer.flush(30)
    assert fences_in(database) == (3, [1, 2, 3])


def fences_in(database):
    with database.transaction() as tx:
        (lease,) = tx.rows("SELECT fence FROM control_leases WHERE ended_at IS NOT NULL")
        drives = tx.rows("SELECT fence FROM drives WHERE ended_at IS NOT NULL ORDER BY fence")
    return lease["fence"], [drive["fence"] for drive in drives]


async def test_a_number_that_comes_too_late_is_not_given(
    *, mariadb, admin_database, ann, monkeypatch
):
    """Else its lease would stay open in the database; and while it hangs nobody waits for it again."""
    monkeypatch.setattr(module, "BRIEF_S", 0.2)
    relay_database = RelayDatabase(Database(mariadb.settings("relay")), "main")
    with admin_database.transaction() as tx:
        robot_id = robots.get(tx, "sim1").id
    lease = NewLease(robot_id, ann.id, "ann", dt.datetime.now(dt.UTC))
    assert await relay_database.next_fence(lease) == 1
    with admin_database.transaction() as tx:
        tx.row("SELECT fence FROM control_leases FOR UPDATE")
        for why in (r"no answer in 0\.2 s", "it hangs"):
            with pytest.raises(StoreUnavailableError, match=why):
                await relay_database.next_fence(lease)
        assert relay_database._open == 1
    await until(lambda: relay_database._open == 0, "the late answer has come")
    await relay_database.changes()
    assert await relay_database.next_fence(lease) == 2
    relay_database.close()
