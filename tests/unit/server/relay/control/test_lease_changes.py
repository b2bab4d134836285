"""Each change of control by itself, without a network: what is written, and what robot and people are told."""

import asyncio
import json
from dataclasses import replace
from types import SimpleNamespace

import pytest
from fake_robot import WAIT_S
from relay_clients import SlowFences
from relay_server import ANN, BEN, CARL, until, utc
from robotether_server.db.control import LeaseEnd, LeaseStart
from robotether_server.db.fleet import AuditEntry, RelayRequest
from robotether_server.relay.control import leasing
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import ConnectionClosedError
from robotether_server.relay.robots import lease as lease_module
from robotether_server.relay.robots.connection import Connection
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.robot import GuardReport, Presence

NOON = utc(2026, 1, 1, 12, 0)


def asker(user):
    return leasing.LeaseRequester(user, "198.51.100.9")


class Bare:
    """Leasing alone: its robot, its event writer, and what robot, drivers and watchers are told."""

    def __init__(self, sim1, memory_database):
        self.robot = sim1
        self.written = []
        self.lines = []
        self.changed = []
        self.ends = []
        self.reported = asyncio.Event()
        self.reported.set()
        self.registry = SessionRegistry()
        link = SimpleNamespace(
            send=lambda line: self.lines.append(json.loads(line)),
            until_guard_reported=self.reported.wait,
        )
        self.state = self.registry.ensure_robot(sim1.id)
        self.state.links["session"] = link
        self.state.presence = Presence(online=True)
        self.leasing = leasing.Leasing(
            database=memory_database,
            event_writer=SimpleNamespace(add=self.written.append),
            registry=self.registry,
            stopped=lambda _robot: None,
            changed=self.changed.append,
        )

    async def drives(self, user):
        connection = Connection(user.id, user.name, self.robot, "drive", self.ends.append)
        await self.leasing.begin(connection)
        return connection

    @property
    def codes(self):
        return [end.code for end in self.ends]

    def audit(self):
        lines = [entry for entry in self.written if isinstance(entry, AuditEntry)]
        return [(line.kind, line.actor, dict(line.details)) for line in lines]

    def ended(self):
        ends = [entry for entry in self.written if isinstance(entry, LeaseEnd)]
        return [(end.robot_id, end.fence) for end in ends]


@pytest.fixture
def bare(sim1, memory_database):
    made = Bare(sim1, memory_database)
    yield made
    made.registry.close()


async def test_a_lease_is_kept_for_who_is_to_help_with_the_right_to_drive(bare, sim1):
    """Watchers are notified when that begins and ends, and not at each poll."""
    requests = [
        RelayRequest(sim1.id, "waiting", 9.0, 9.0, None, None),
        RelayRequest(sim1.id, "offered", 5.0, 5.0, BEN, 20.0),
    ]
    bare.leasing.reserve(requests, lambda user_id, _robot_id: user_id != BEN.id)
    # Of a database whose clock was set back.
    bare.leasing.reserve([replace(requests[1], left_s=3600.0)], lambda *_pair: True)
    assert bare.changed == []
    for _ in range(2):
        bare.leasing.reserve(requests, lambda *_pair: True)
    assert bare.changed == [sim1.id]
    with pytest.raises(ConnectionClosedError, match="ben"):
        await bare.drives(CARL)
    bare.leasing.reserve([], lambda *_pair: True)
    assert bare.changed == [sim1.id] * 2
    await bare.drives(CARL)


async def test_each_change_of_control_is_written_with_who_and_whom(bare, sim1):
    acts = bare.leasing
    await bare.drives(ANN)
    acts.ask(sim1, asker(BEN))
    acts.refuse(sim1, asker(ANN))
    acts.ask(sim1, asker(BEN))
    acts.withdraw(sim1, asker(BEN))
    acts.ask(sim1, asker(BEN))
    acts.hand_over(sim1, asker(ANN), "ben")
    await bare.drives(BEN)
    acts.take(sim1, asker(CARL))
    assert bare.audit() == [
        ("lease_asked", "ben", {}),
        ("lease_refused", "ann", {"to": "ben"}),
        ("lease_asked", "ben", {}),
        ("lease_asked", "ben", {}),
        ("lease_handed_over", "ann", {"to": "ben"}),
        ("lease_taken", "carl", {"driver": "ben"}),
    ]
    assert bare.ended() == [(sim1.id, 1), (sim1.id, 2)]
    assert bare.codes == [4010, 4010]
    assert bare.lines[-1] == {"type": "lease", "fence": 2, "held": False}
    assert set(bare.changed) == {sim1.id}


async def test_a_guard_that_reports_nothing_keeps_nobody_waiting_for_long(bare, sim1, monkeypatch):
    """It may not have started yet; the lease has the number that is known here."""
    monkeypatch.setattr(leasing, "GUARD_REPORTS_WITHIN_S", 0.05)
    bare.reported.clear()
    bare.leasing.remember({sim1.id: 41})
    async with asyncio.timeout(WAIT_S):
        await bare.drives(ANN)
    assert bare.leasing.of(sim1.id).fence == 42


async def test_of_two_claims_the_older_hears_of_the_newer(bare, sim1, memory_database, monkeypatch):
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


async def test_a_lease_without_the_database_is_written_as_it_began(
    bare, sim1, memory_database, monkeypatch
):
    monkeypatch.setattr(leasing, "utc_now", lambda: NOON)
    memory_database.down = True
    bare.leasing.remember({sim1.id: 41})
    reports = GuardReport("down", fence=50)
    bare.state.presence = Presence(online=True, guard_mode="on", report=reports)
    with pytest.raises(ConnectionClosedError):
        await bare.drives(ANN)
    assert bare.written == []
    bare.state.presence = replace(bare.state.presence, report=replace(reports, state="ready"))
    await bare.drives(ANN)
    assert bare.written == [LeaseStart(sim1.id, 51, ANN.id, "ann", NOON)]


async def test_a_stop_ends_the_lease_in_the_books_and_for_all_who_watch(bare, sim1):
    await bare.drives(ANN)
    bare.changed.clear()
    bare.leasing.revoke(sim1.id, close_reasons.link_lost("sim1"))
    assert bare.ended() == [(sim1.id, 1)]
    assert (len(bare.ends), bare.changed) == (1, [sim1.id])
    assert bare.lines[-1]["fence"] == 1


async def test_what_passes_by_itself_is_written_with_who_drove(bare, sim1, monkeypatch):
    monkeypatch.setattr(lease_module, "PASSES_AFTER_S", 0.05)
    await bare.drives(ANN)
    bare.leasing.ask(sim1, asker(BEN))
    await until(lambda: bare.codes == [4010], "the control passes on")
    assert bare.audit()[-1] == ("lease_passed", "ben", {"driver": "ann"})
    assert bare.ended() == [(sim1.id, 1)]


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
