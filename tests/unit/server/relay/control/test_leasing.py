"""Leases through the whole relay: who drives, who waits, and what robots and drivers are told.

Long, as each module has one file of tests (test_structure.py).
"""

from __future__ import annotations

import asyncio
import json
from dataclasses import replace
from types import SimpleNamespace

import pytest
from fake_robot import WAIT_S, FakeRobot
from msgspec import structs
from relay_clients import PUBLISH, audit_lines, closing
from relay_server import SESSION_KEY, until, utc
from robotether_common.session import MAX_FENCE
from robotether_server.db.control import DriveEntry, LeaseEnd, LeaseStart, NewLease
from robotether_server.db.fleet import AuditEntry, RelayUser
from robotether_server.problems import (
    RecordMissing,
    RecordRefused,
    StoreUnavailable,
)
from robotether_server.relay.auth.connections import Connection
from robotether_server.relay.control import leases, leasing
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import CloseReason, ConnectionClosedError
from robotether_server.relay.robots.sessions import GuardReport, Presence

ANN, BEN, CARL = RelayUser(1, "ann"), RelayUser(3, "ben"), RelayUser(4, "carl")
NOON = utc(2026, 1, 1, 12, 0)


@pytest.fixture(autouse=True)
def rights(memory_database, sim1):
    """Let ben drive and carl manage sim1, beside ann who drives."""
    memory_database.grants[BEN.id, sim1.id] = "drive"
    memory_database.grants[CARL.id, sim1.id] = "manage"


@pytest.fixture(autouse=True)
def no_command_is_late(memory_database, sim1):
    """A client that does not read answers no ping, and its commands grow old while the machine is busy."""
    guard = structs.replace(sim1.settings.guard, max_age_ms=60_000)
    settings = structs.replace(sim1.settings, guard=guard)
    memory_database.robots[sim1.id] = replace(sim1, settings=settings)


def control(relay, sim1):
    return relay.relay.control.describe(sim1.id)


def asker(user: RelayUser) -> leasing.LeaseRequester:
    return leasing.LeaseRequester(user, "198.51.100.9")


async def driven(relay, sim1, user: RelayUser = ANN) -> None:
    await until(lambda: relay.relay.control.driver(sim1.id) == user.name, f"{user.name} drives")


async def read_all(socket) -> None:
    async for _ in socket:
        pass


async def test_a_second_driver_is_told_who_drives(relay, guarded, sim1, http):
    """The first goes on; the second's reason has name and time."""
    async with http.ws_connect(relay.ros_url(sim1)) as first:
        await guarded.connections(1)
        async with http.ws_connect(relay.ros_url(sim1, "drive", BEN)) as second:
            code, reason = await closing(second)
        assert code == 4009
        assert reason.startswith("ann has been driving sim1 since ")
        assert control(relay, sim1)["driver"]["user"] == "ann"
        await first.ping()
        assert guarded.clients_ever == 1


async def test_the_robot_hears_of_each_lease(relay, guarded, sim1, http):
    """First that nobody drives; the number before its connection comes; and the end with the same number."""
    assert guarded.session.leases[0] == {"type": "lease", "fence": 0, "held": False}
    async with http.ws_connect(relay.ros_url(sim1)):
        await guarded.connections(1)
        assert guarded.session.leases[-1] == {"type": "lease", "fence": 1, "held": True}
    await until(lambda: not guarded.session.leases[-1]["held"], "the robot hears of the end")
    assert guarded.session.leases[-1]["fence"] == 1


async def test_a_new_lease_is_above_what_the_guard_knows(relay, guarded, sim1, http):
    """The robot may come from another relay, or the database from an older copy."""
    guarded.session.send_guard_status(fence=500)
    await until(lambda: relay.relay.registry.presence(sim1.id).report.fence == 500, "it is known")
    async with http.ws_connect(relay.ros_url(sim1)):
        (handshake,) = await guarded.connections(1)
    assert handshake["Robotether-Fence"] == "501"


@pytest.mark.parametrize("lie", [2**53 - 1, MAX_FENCE])
async def test_a_robot_that_lied_of_its_fence_can_be_driven_when_it_is_mended(
    relay, guarded, sim1, http, lie
):
    """There are numbers above any that a robot can report, and its guard may report those."""
    presence = relay.relay.registry.presence
    guarded.session.send_guard_status(fence=lie)
    await until(lambda: presence(sim1.id).report.fence, "it is known")
    for handshakes in (1, 2):
        async with http.ws_connect(relay.ros_url(sim1)):
            fence = int((await guarded.connections(handshakes))[-1]["Robotether-Fence"])
            assert 2**53 <= fence < MAX_FENCE
            guarded.session.send_guard_status(fence=fence, held=handshakes)
            count = ("held", handshakes)
            await until(
                lambda count=count: count in presence(sim1.id).report.refused, "the session lives"
            )


async def test_a_new_lease_waits_for_the_guards_first_report(relay, sim1, http):
    """Who is faster than that drives at the first attempt, too."""
    robot = FakeRobot(sim1.id, SESSION_KEY, "guard_quiet")
    await robot.start(relay.relay.session_port)
    try:
        async with http.ws_connect(relay.ros_url(sim1)):
            await until(lambda: relay.relay.usage.of(sim1.id), "the driver is there")
            assert not robot.handshakes
            robot.session.send_guard_status(fence=500)
            (handshake,) = await robot.connections(1)
        assert handshake["Robotether-Fence"] == "501"
    finally:
        await robot.stop()


async def test_a_robot_without_a_guard_keeps_nobody_waiting(relay, robot, sim1, http, monkeypatch):
    """Its agent has said that no report will come."""
    monkeypatch.setattr(leasing, "GUARD_REPORTS_WITHIN_S", WAIT_S * 10)
    async with http.ws_connect(relay.ros_url(sim1)):
        await driven(relay, sim1)


async def test_what_the_guard_refuses_stands_in_the_drives_record(
    relay, guarded, sim1, http, memory_database
):
    """Also what it tells when the drive is over."""

    def refused() -> dict[str, int]:
        drives = [entry for entry in memory_database.written if isinstance(entry, DriveEntry)]
        return drives[-1].refused if drives else {}

    async with http.ws_connect(relay.ros_url(sim1)):
        await guarded.connections(1)
        guarded.session.send_guard_status(old=2)
    await until(lambda: control(relay, sim1)["driver"] is None, "nobody drives")
    guarded.session.send_guard_status(old=2, shape=1)
    await until(lambda: refused() == {"guard_old": 2, "guard_shape": 1}, "the record has both")


async def test_what_a_drive_was_like_stands_in_its_record(
    relay, guarded, sim1, http, memory_database
):
    """Round trips, bytes of both directions, and the frames that this driver got of this robot meanwhile."""
    viewer_stats, observer = relay.relay.viewer_stats, relay.relay.observer

    def record() -> DriveEntry | None:
        observer.write_drives()
        return next((one for one in memory_database.written if isinstance(one, DriveEntry)), None)

    viewer_stats.count(sim1.id, ANN.id, 5000)
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        # A client answers pings while it reads.
        reading = asyncio.create_task(read_all(socket))
        await guarded.connections(1)
        # On a busy machine the first may count as old, until a pong bounds its age.
        async with asyncio.timeout(WAIT_S):
            while not guarded.received:
                await socket.send_str(PUBLISH)
                await asyncio.sleep(0.05)
        viewer_stats.count(sim1.id, ANN.id, 700)
        viewer_stats.count(sim1.id, BEN.id, 90)
        await until(lambda: (one := record()) and one.latency_p50_ms, "a round trip is measured")
        await socket.close()
        await reading
    await until(lambda: record().ended_at, "the drive is over")
    entry = record()
    assert 0 < entry.latency_p50_ms <= entry.latency_p95_ms
    assert (entry.pictures, entry.picture_bytes, entry.viewed_s) == (1, 700, 0.0)
    assert entry.bytes >= len(guarded.received[0])


async def test_a_users_newer_connection_takes_over(relay, guarded, sim1, http):
    """The older is closed with 4002, and the newer has a higher number."""
    async with http.ws_connect(relay.ros_url(sim1)) as older:
        await driven(relay, sim1)
        async with http.ws_connect(relay.ros_url(sim1)) as newer:
            assert (await closing(older))[0] == 4002
            await until(lambda: control(relay, sim1)["driver"], "the newer drives")
            assert control(relay, sim1)["driver"]["fence"] == 2
            await newer.ping()
        await until(lambda: control(relay, sim1)["driver"] is None, "nobody drives")


async def test_the_driver_hands_over_to_who_asks(relay, guarded, sim1, http, memory_database):
    """The driver is closed with 4010; only who asked gets the lease; the records say so."""
    acts = relay.relay.control.leasing
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        await until(lambda: guarded.clients, "ann has reached the robot")
        acts.ask(sim1, asker(BEN))
        assert control(relay, sim1)["waiting"]["user"] == "ben"
        acts.hand_over(sim1, asker(ANN))
        assert await closing(socket) == (4010, "ben controls sim1 now")
    assert control(relay, sim1)["reserved"]["user"] == "ben"
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        assert await closing(socket) == (4009, "control of sim1 is reserved for ben; wait a moment")
    async with http.ws_connect(relay.ros_url(sim1, "drive", BEN)):
        await driven(relay, sim1, BEN)
        assert control(relay, sim1)["reserved"] is None
    await relay.relay.event_writer.flush(5)
    kinds = [line.kind for line in audit_lines(memory_database)]
    assert kinds[:3] == ["drive_started", "lease_asked", "lease_handed_over"]


async def test_commands_put_off_that_the_control_passes_on(relay, guarded, sim1, http):
    """Only messages on a drive topic show that the driver is there."""
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        await driven(relay, sim1)
        relay.relay.control.leasing.ask(sim1, asker(BEN))
        lease = relay.relay.control.leasing.of(sim1.id)
        before = lease.passes_at().s
        await socket.send_json({"op": "subscribe", "topic": "/pose"})
        await until(lambda: guarded.received, "the robot has the subscription")
        assert lease.passes_at().s == before
        await socket.send_json({"op": "publish", "topic": "/cmd_vel", "msg": {}})
        await until(lambda: lease.passes_at().s > before, "the command is noted")


async def test_a_kept_lease_is_free_after_its_time(relay, guarded, sim1, http, monkeypatch):
    """Who asked and does not come keeps nobody out for long, and those who watch are told."""
    monkeypatch.setattr(leases, "RESERVED_FOR_S", 0.2)
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        await driven(relay, sim1)
        relay.relay.control.leasing.take(sim1, asker(CARL))
        assert (await closing(socket))[0] == 4010
    free: list[bool] = []
    relay.relay.control.listen(
        lambda _robot_id: free.append(control(relay, sim1)["reserved"] is None)
    )
    await until(lambda: True in free, "those who watch are told")


async def test_without_a_database_nobody_new_begins_to_drive(
    relay, guarded, sim1, http, memory_database
):
    """A login that the relay has not seen lately is 4510, while an observer comes in."""
    memory_database.down = True
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        assert (await closing(socket))[0] == 4510
    async with http.ws_connect(relay.ros_url(sim1, "observe", BEN)):
        await guarded.connections(1)
    assert guarded.handshakes[0]["Robotether-Mode"] == "observe"
    memory_database.down = False
    async with http.ws_connect(relay.ros_url(sim1)):
        await driven(relay, sim1)


async def test_without_a_database_who_drove_lately_drives_again(
    relay, guarded, sim1, http, memory_database
):
    """With the relay's own number, above the guard's; the record has it once the database is back."""
    async with http.ws_connect(relay.ros_url(sim1)):
        await driven(relay, sim1)
    await until(lambda: memory_database.fences == {sim1.id: 1}, "the first has its number")
    memory_database.down = True
    guarded.session.send_guard_status(fence=7)
    await until(lambda: relay.relay.registry.presence(sim1.id).report.fence == 7, "it is known")
    async with http.ws_connect(relay.ros_url(sim1)):
        handshakes = await guarded.connections(2)
    await until(lambda: control(relay, sim1)["driver"] is None, "nobody drives")
    assert handshakes[-1]["Robotether-Fence"] == "8"
    assert memory_database.fences == {sim1.id: 1}
    memory_database.down = False
    await until(lambda: leases_written(memory_database)[-1:] == [(LeaseEnd, 8)], "it is written")
    assert leases_written(memory_database)[-2:] == [(LeaseStart, 8), (LeaseEnd, 8)]


async def test_without_a_database_who_has_a_newer_ticket_drives(
    relay, guarded, sim1, http, memory_database
):
    """Another cell's web, which the database answers, has signed it."""
    memory_database.down = True
    await until(lambda: not relay.relay.fleet.store_up, "the relay gets no answer")
    relay.relay.credentials._answered_at -= 10
    async with http.ws_connect(relay.ros_url(sim1)):
        await driven(relay, sim1)


async def test_without_a_database_a_newer_connection_of_the_driver_takes_over(
    relay, guarded, sim1, http, memory_database
):
    async with http.ws_connect(relay.ros_url(sim1)) as first:
        await driven(relay, sim1)
        memory_database.down = True
        async with http.ws_connect(relay.ros_url(sim1)):
            assert (await closing(first))[0] == 4002
            assert control(relay, sim1)["driver"]["fence"] == 2


async def test_without_a_database_nobody_drives_a_robot_without_a_guard(
    relay, robot, sim1, http, memory_database
):
    """4510: it would take commands of a driver who has lost control."""
    async with http.ws_connect(relay.ros_url(sim1)):
        await driven(relay, sim1)
        memory_database.down = True
        async with http.ws_connect(relay.ros_url(sim1)) as second:
            assert (await closing(second))[0] == 4510
        assert control(relay, sim1)["driver"]["fence"] == 1


def leases_written(memory_database) -> list[tuple[type, int]]:
    kinds = LeaseStart | LeaseEnd
    return [(type(one), one.fence) for one in memory_database.written if isinstance(one, kinds)]


class SlowFences:
    """Has the database number drives once the test lets it."""

    def __init__(self, memory_database) -> None:
        self.asked, self.go_on = asyncio.Event(), asyncio.Event()
        self._next_fence = memory_database.next_fence

    async def next_fence(self, lease: NewLease) -> int:
        self.asked.set()
        await self.go_on.wait()
        return await self._next_fence(lease)


async def test_a_stop_while_the_number_is_on_its_way_wins(
    *, relay, guarded, sim1, http, memory_database, monkeypatch
):
    """Nobody drives a robot that was stopped before the database answered."""
    slow = SlowFences(memory_database)
    monkeypatch.setattr(memory_database, "next_fence", slow.next_fence)
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        await slow.asked.wait()
        relay.relay.control.stops.stop(sim1, "ben")
        assert (await closing(socket))[0] == 4003
        slow.go_on.set()
    assert relay.relay.control.driver(sim1.id) is None
    assert guarded.clients_ever == 0


async def test_a_newer_connection_hears_of_a_stop_too(
    *, relay, guarded, sim1, http, memory_database, monkeypatch
):
    """The one that drives and the one that waits for its number both end with the stop."""
    slow = SlowFences(memory_database)
    async with http.ws_connect(relay.ros_url(sim1)) as older:
        await guarded.connections(1)
        monkeypatch.setattr(memory_database, "next_fence", slow.next_fence)
        async with http.ws_connect(relay.ros_url(sim1)) as newer:
            await slow.asked.wait()
            relay.relay.control.stops.stop(sim1, "ben")
            assert (await closing(older))[0] == 4003
            slow.go_on.set()
            assert (await closing(newer))[0] == 4003
    assert relay.relay.control.driver(sim1.id) is None
    assert guarded.clients_ever == 1


async def test_a_lost_link_ends_the_lease(relay, guarded, sim1, http, memory_database):
    """4505, and the next session hears that the number is over."""
    async with http.ws_connect(relay.ros_url(sim1)) as socket:
        await driven(relay, sim1)
        await guarded.session.close()
        assert (await closing(socket))[0] == 4505
    assert control(relay, sim1)["driver"] is None
    await until(
        lambda: any(isinstance(e, LeaseEnd) for e in memory_database.written), "it is written"
    )


async def test_who_lost_the_right_waits_no_more(relay, guarded, sim1, http, memory_database):
    """A question ends with the grant of who asked."""
    async with http.ws_connect(relay.ros_url(sim1)):
        await driven(relay, sim1)
        relay.relay.control.leasing.ask(sim1, asker(BEN))
        del memory_database.grants[BEN.id, sim1.id]
        await until(lambda: control(relay, sim1)["waiting"] is None, "nobody waits")


class Bare:
    """Leasing alone: its robot, its event writer, and what robot, drivers and watchers are told."""

    def __init__(self, sim1, memory_database) -> None:
        self.robot = sim1
        self.written: list[AuditEntry | LeaseEnd] = []
        self.lines: list[dict[str, object]] = []
        self.changed: list[int] = []
        self.ends: list[CloseReason] = []
        self.reported = asyncio.Event()
        self.reported.set()
        link = SimpleNamespace(
            send=lambda line: self.lines.append(json.loads(line)),
            until_guard_reported=self.reported.wait,
        )
        self.presence = Presence()
        self.leasing = leasing.Leasing(
            database=memory_database,
            event_writer=SimpleNamespace(add=self.written.append),
            registry=SimpleNamespace(
                session_of={sim1.id: link}.get, presence=lambda _robot_id: self.presence
            ),
            stopped=lambda _robot: None,
            changed=self.changed.append,
        )

    async def drives(self, user: RelayUser) -> Connection:
        connection = Connection(
            user.id,
            user.name,
            self.robot,
            "drive",
            self.ends.append,
        )
        await self.leasing.begin(connection)
        return connection

    @property
    def codes(self) -> list[int]:
        return [end.code for end in self.ends]

    def audit(self) -> list[tuple[str, str, object]]:
        lines = [one for one in self.written if isinstance(one, AuditEntry)]
        return [(line.kind, line.actor, dict(line.details)) for line in lines]

    def ended(self) -> list[tuple[int, int]]:
        ends = [one for one in self.written if isinstance(one, LeaseEnd)]
        return [(end.robot_id, end.fence) for end in ends]


@pytest.fixture
def bare(sim1, memory_database):
    made = Bare(sim1, memory_database)
    yield made
    made.leasing.close()


async def test_each_change_of_control_is_written_with_who_and_whom(bare, sim1):
    """Who did it, who drove or gets it, and the number that is over."""
    acts = bare.leasing
    await bare.drives(ANN)
    acts.ask(sim1, asker(BEN))
    acts.refuse(sim1, asker(ANN))
    acts.ask(sim1, asker(BEN))
    acts.hand_over(sim1, asker(ANN), "ben")
    await bare.drives(BEN)
    acts.take(sim1, asker(CARL))
    assert bare.audit() == [
        ("lease_asked", "ben", {}),
        ("lease_refused", "ann", {"to": "ben"}),
        ("lease_asked", "ben", {}),
        ("lease_handed_over", "ann", {"to": "ben"}),
        ("lease_taken", "carl", {"driver": "ben"}),
    ]
    assert bare.ended() == [(sim1.id, 1), (sim1.id, 2)]
    assert bare.codes == [4010, 4010]
    assert bare.lines[-1] == {"type": "lease", "fence": 2, "held": False}
    assert set(bare.changed) == {sim1.id}


async def test_what_is_written_says_who_where_and_when(bare, sim1, memory_database, monkeypatch):
    """A new lease for the database, and its end and the audit log."""
    next_fence, asked = memory_database.next_fence, []

    async def noted(lease):
        asked.append(lease)
        return await next_fence(lease)

    monkeypatch.setattr(memory_database, "next_fence", noted)
    monkeypatch.setattr(leasing, "utc_now", lambda: NOON)
    bare.leasing.remember({sim1.id: 41})
    await bare.drives(ANN)
    bare.leasing.take(sim1, asker(CARL))
    assert asked == [NewLease(sim1.id, ANN.id, "ann", NOON, above=41)]
    assert bare.written == [
        AuditEntry(NOON, "carl", "lease_taken", "sim1", "198.51.100.9", {"driver": "ann"}),
        LeaseEnd(sim1.id, 42, NOON),
    ]
    assert bare.ends == [close_reasons.lease_lost("sim1", "carl")]


async def test_a_guard_that_reports_nothing_keeps_nobody_waiting_for_long(bare, sim1, monkeypatch):
    """It may not have started yet; the lease has the number that is known here."""
    monkeypatch.setattr(leasing, "GUARD_REPORTS_WITHIN_S", 0.05)
    bare.reported.clear()
    bare.leasing.remember({sim1.id: 41})
    async with asyncio.timeout(WAIT_S):
        await bare.drives(ANN)
    assert bare.leasing.of(sim1.id).fence == 42


async def test_of_two_claims_the_older_hears_of_the_newer(bare, sim1, memory_database, monkeypatch):
    """While both wait for a number; the newer drives in the end."""
    slow = SlowFences(memory_database)
    monkeypatch.setattr(memory_database, "next_fence", slow.next_fence)
    older, newer = (asyncio.create_task(bare.drives(ANN)) for _ in range(2))
    await until(lambda: bare.ends, "the older hears of it")
    slow.go_on.set()
    drives = await newer
    with pytest.raises(ConnectionClosedError) as lost:
        await older
    assert bare.ends == [close_reasons.superseded("sim1")]
    assert lost.value.close_reason == close_reasons.lease_unavailable("sim1")
    assert bare.leasing.of(sim1.id).driver.holder is drives


@pytest.mark.parametrize(
    ("problem", "close_reason"),
    [
        (RecordMissing, close_reasons.rights_ended),
        (RecordRefused, close_reasons.rights_ended),
        (StoreUnavailable, close_reasons.lease_unavailable),
    ],
)
async def test_who_gets_no_number_hears_why(
    *, bare, sim1, memory_database, monkeypatch, problem, close_reason
):
    """By the name of the robot, and with a code of its own."""

    async def fails(_lease):
        raise problem("the test wants it")

    monkeypatch.setattr(memory_database, "next_fence", fails)
    with pytest.raises(ConnectionClosedError) as lost:
        await bare.drives(ANN)
    assert lost.value.close_reason == close_reason("sim1")


async def test_a_lease_without_the_database_is_written_as_it_began(
    bare, sim1, memory_database, monkeypatch
):
    """Only once it is granted, and only while the guard is there that refuses the older ones."""
    monkeypatch.setattr(leasing, "utc_now", lambda: NOON)
    memory_database.down = True
    bare.leasing.remember({sim1.id: 41})
    reports = GuardReport("down", fence=50)
    bare.presence = Presence(online=True, guard_mode="on", report=reports)
    with pytest.raises(ConnectionClosedError):
        await bare.drives(ANN)
    assert bare.written == []
    bare.presence = Presence(online=True, guard_mode="on", report=replace(reports, state="ready"))
    await bare.drives(ANN)
    assert bare.written == [LeaseStart(sim1.id, 51, ANN.id, "ann", NOON)]


async def test_who_takes_the_question_back_gets_nothing(bare, sim1):
    """Nobody waits then, and the control stays where it is."""
    await bare.drives(ANN)
    bare.leasing.ask(sim1, asker(BEN))
    told = len(bare.lines)
    bare.leasing.withdraw(sim1, asker(BEN))
    assert bare.leasing.of(sim1.id).waiting is None
    assert len(bare.lines) == told + 1


async def test_what_passes_by_itself_is_written_with_who_drove(bare, sim1, monkeypatch):
    """And the driver's connection is over, and its number."""
    monkeypatch.setattr(leases, "PASSES_AFTER_S", 0.05)
    await bare.drives(ANN)
    bare.leasing.ask(sim1, asker(BEN))
    await until(lambda: bare.codes == [4010], "the control passes on")
    assert bare.audit()[-1] == ("lease_passed", "ben", {"driver": "ann"})
    assert bare.ended() == [(sim1.id, 1)]


async def test_the_right_to_drive_is_asked_for_of_who_waits_at_this_robot(bare, sim1):
    """Who may drive waits on; who may not does not."""
    asked: list[tuple[int, int]] = []

    def may_drive(user_id: int, robot_id: int) -> bool:
        asked.append((user_id, robot_id))
        return len(asked) == 1

    await bare.drives(ANN)
    bare.leasing.ask(sim1, asker(BEN))
    told = len(bare.lines)
    bare.leasing.keep_only(may_drive)
    assert bare.leasing.of(sim1.id).waiting is not None
    assert len(bare.lines) == told
    bare.leasing.keep_only(may_drive)
    assert bare.leasing.of(sim1.id).waiting is None
    assert len(bare.lines) == told + 1
    assert asked == [(BEN.id, sim1.id)] * 2


async def test_a_claim_that_is_lost_meanwhile_hears_to_whom(
    bare, sim1, memory_database, monkeypatch
):
    """A manager takes the control while the driver's newer connection waits for its number."""
    await bare.drives(ANN)
    next_fence = memory_database.next_fence

    async def taken_meanwhile(lease):
        bare.leasing.take(sim1, asker(CARL))
        return await next_fence(lease)

    monkeypatch.setattr(memory_database, "next_fence", taken_meanwhile)
    with pytest.raises(ConnectionClosedError) as lost:
        await bare.drives(ANN)
    assert lost.value.close_reason.code == 4009
    assert lost.value.close_reason.reason == "control of sim1 is reserved for carl; wait a moment"
    assert bare.leasing.of(sim1.id).driver is None
    assert bare.ended() == [(sim1.id, 1), (sim1.id, 2)]


async def test_only_robots_that_are_gone_are_forgotten(bare, sim1, monkeypatch):
    """With their timers: nothing passes on at a robot that is not there any more."""
    monkeypatch.setattr(leases, "PASSES_AFTER_S", 0.05)
    await bare.drives(ANN)
    bare.leasing.ask(sim1, asker(BEN))
    bare.leasing.forget_all_but([sim1.id])
    assert bare.leasing.count() == 1
    bare.leasing.forget_all_but([sim1.id + 1])
    assert bare.leasing.count() == 0
    await asyncio.sleep(0.1)
    assert bare.codes == []
