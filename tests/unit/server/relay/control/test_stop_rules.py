"""Each rule of stops by itself, without a network: what is sent, written, shown, repeated and told to other cells."""

import asyncio
import itertools
import json
import random
from dataclasses import dataclass, field, replace
from datetime import timedelta
from typing import Any
from unittest.mock import ANY

import pytest
from fake_robot import WAIT_S
from relay_server import until, utc
from robotether_server.contract.control import ShownStop
from robotether_server.db.control import Stop, StopEntry
from robotether_server.db.fleet import AuditEntry, RelayRobot, Snapshot
from robotether_server.problems import GuardSilentError, NotPossibleError
from robotether_server.relay.control import stops as stops_module
from robotether_server.relay.control.stops import Stops
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import ConnectionClosedError
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.robot import GuardReport
from robotether_server.relay.robots.robot_stops import MAX_STOPS

NOON = utc(2026, 1, 1, 12, 0)
SIM1, SIM2 = (RelayRobot(at, f"sim{at - 6}", "active", 2000 + at, 3000 + at) for at in (7, 8))
STOPPED = GuardReport("ready", stopped=True, by="ben")


@dataclass(eq=False)
class FakeLink:
    robot_id: int = SIM1.id
    kind: str = "session"
    address: str = "198.51.100.7"
    sent: list[dict[str, Any]] = field(default_factory=list)

    def send(self, line):
        self.sent.append(json.loads(line))

    @property
    def kinds(self):
        return [line["type"] for line in self.sent]


class World:
    """The stops of two robots, and what their surroundings are told."""

    def __init__(self):
        self.registry = SessionRegistry(clock=lambda: NOON)
        self.written = []
        self.revoked = []
        self.changed = []
        self.stops = Stops(
            event_writer=self,
            registry=self.registry,
            robots=lambda: {SIM1.id: SIM1, SIM2.id: SIM2},
            revoke=lambda robot_id, why: self.revoked.append((robot_id, why)),
            changed=self.changed.append,
        )
        self.registry.listen(self.stops.on_robot_change)

    @property
    def robot(self):
        return self.registry.robot(SIM1.id)

    @property
    def audit(self):
        return [entry for entry in self.written if isinstance(entry, AuditEntry)]

    def add(self, entry):
        self.written.append(entry)

    def online(self, guard="on"):
        link = FakeLink()
        self.registry.make_current(link)
        self.registry.established(link)
        self.registry.on_hello(link, "0.1.0", guard)
        return link

    async def releasing(self, link):
        release = asyncio.create_task(self.stops.release(SIM1, "ann"))
        await until(lambda: "release" in link.kinds, "it is on its way")
        return release


@pytest.fixture
async def world():
    world = World()
    yield world
    world.registry.close()


async def test_a_stop_is_sent_shown_and_written(world):
    link = world.online()
    world.stops.stop(SIM1, "ben", reason="smoke", address="198.51.100.9")
    stop = world.stops.of(SIM1.id)
    assert stop == Stop(SIM1.id, ANY, "ben", "smoke")
    assert link.sent == [{"type": "stop", "id": ANY, "by": "ben"}]
    assert len(link.sent[0]["id"]) == 2 * stops_module.MESSAGE_ID_BYTES
    why = close_reasons.robot_stopped("sim1", "ben", stop.at)
    assert world.revoked == [(SIM1.id, why)]
    # A robot that connects is greeted with it.
    assert [json.loads(line)["by"] for line in world.stops.greeting(SIM1.id)] == ["ben"]
    assert world.stops.greeting(SIM2.id) == []
    assert world.stops.close_reason(SIM1) == why
    assert world.stops.close_reason(SIM2) is None
    assert world.changed == [SIM1.id]
    audit = AuditEntry(ANY, "ben", "robot_stopped", "sim1", "198.51.100.9", {"reason": "smoke"})
    assert world.written == [StopEntry(SIM1.id, stop), audit]
    assert world.stops.count() == 1


async def test_a_release_without_a_guard_is_written(world):
    """Nobody needs to confirm it, and the robot hears nothing."""
    link = world.online("off")
    world.stops.stop(SIM1, "ben")
    world.written.clear()
    await world.stops.release(SIM1, "ann", address="198.51.100.9")
    audit = AuditEntry(ANY, "ann", "robot_released", "sim1", "198.51.100.9", {})
    assert world.written == [StopEntry(SIM1.id, None), audit]
    assert world.changed == [SIM1.id, SIM1.id]
    assert world.stops.count() == 0
    assert link.kinds == ["stop"]


@pytest.mark.parametrize("by", ["ben", "b" * 63, "somebody at the robot (ben)"])
async def test_a_stop_at_the_robot_is_written_as_the_robots(world, by):
    """Its name is a claim; one that went to the robot and came back stays as it was."""
    link = world.online()
    world.registry.on_guard_status(link, replace(STOPPED, by=by), None)
    name = world.stops.of(SIM1.id).by
    assert name.startswith("somebody at the robot (b")
    assert (name.count("("), len(name) <= 63) == (1, True)
    audit = AuditEntry(ANY, name, "robot_stopped", "sim1", None, {"told_by": "robot"})
    assert world.written == [StopEntry(SIM1.id, Stop(SIM1.id, ANY, name)), audit]


async def test_a_stop_that_comes_again_is_sent_again_but_not_at_once(world, monkeypatch):
    """One that was never sent goes out at the first press."""
    link = world.online()
    world.stops.learn(Stop(SIM1.id, NOON, "ben"), is_written=True)
    world.stops.stop(SIM1, "ben")
    world.stops.stop(SIM1, "ben")
    assert link.kinds == ["stop"]
    monkeypatch.setattr(stops_module, "INSIST_EVERY_S", 0.0)
    world.stops.stop(SIM1, "ben")
    assert link.kinds == ["stop", "stop"]
    world.registry.on_guard_status(link, STOPPED, None)
    world.stops.stop(SIM1, "ben")
    assert link.kinds == ["stop", "stop"]
    assert world.written == []


async def test_a_stop_that_no_guard_confirmed_is_sent_again(world, monkeypatch):
    monkeypatch.setattr(stops_module, "REPEAT_EVERY_S", 0.01)
    link = world.online()
    assert world.robot.stops.repeat_timer is None, "it is not stopped"
    world.stops.learn(Stop(SIM1.id, NOON, "ben"))
    await until(lambda: link.kinds[:2] == ["stop", "stop"], "it is sent again")
    world.registry.on_guard_status(link, STOPPED, None)
    await until(lambda: world.robot.stops.repeat_timer is None, "and no more once it is confirmed")
    link.sent.clear()
    world.registry.on_guard_status(link, GuardReport("ready"), None)
    await until(lambda: "stop" in link.kinds, "but to a guard that forgot it")


async def test_a_guard_that_comes_up_is_sent_the_stop_again(world, monkeypatch):
    """The stop reached the robot before there was anybody to confirm it."""
    monkeypatch.setattr(stops_module, "REPEAT_EVERY_S", 0.01)
    link = world.online("off")
    world.stops.stop(SIM1, "ben")
    world.registry.on_hello(link, "0.1.0", "on")
    await until(lambda: link.kinds[:2] == ["stop", "stop"], "it is sent again")


async def test_all_who_wait_hear_of_the_confirmation_at_once(world, monkeypatch):
    monkeypatch.setattr(stops_module, "CONFIRMED_WITHIN_S", WAIT_S)
    link = world.online()
    world.stops.stop(SIM1, "ben")
    waiting = [asyncio.create_task(world.stops.confirmation(SIM1.id)) for _ in range(2)]
    await asyncio.sleep(0)
    waiting[0].cancel()
    await asyncio.gather(waiting[0], return_exceptions=True)
    waiting.append(asyncio.create_task(world.stops.confirmation(SIM1.id)))
    await asyncio.sleep(0)
    for _ in range(2):
        world.registry.on_guard_status(link, STOPPED, None)
    done, _ = await asyncio.wait(waiting[1:], timeout=WAIT_S / 2)
    assert [task.result() for task in done] == [True, True]
    assert not world.robot.stops.confirmations
    assert await world.stops.confirmation(SIM1.id)


@pytest.mark.parametrize("guard", [None, "off", "unknown"])
async def test_nobody_waits_for_a_guard_that_cannot_answer(world, monkeypatch, guard):
    monkeypatch.setattr(stops_module, "CONFIRMED_WITHIN_S", 60.0)
    if guard is not None:
        world.online(guard)
    world.stops.stop(SIM1, "ben")
    async with asyncio.timeout(WAIT_S):
        assert not await world.stops.confirmation(SIM1.id)
    assert not world.robot.stops.confirmations
    assert world.robot.stops.repeat_timer is None


async def test_a_silent_guard_is_sent_the_stop_after_a_release(world, monkeypatch):
    """The release may have reached it, and its answer not us."""
    monkeypatch.setattr(stops_module, "RELEASED_WITHIN_S", 0.01)
    monkeypatch.setattr(stops_module, "CONFIRMED_WITHIN_S", 0.01)
    link = world.online()
    world.stops.stop(SIM1, "ben")
    assert not await world.stops.confirmation(SIM1.id)
    assert not world.robot.stops.confirmations
    with pytest.raises(GuardSilentError, match=r"guard did not confirm it in 0\.01 s"):
        await world.stops.release(SIM1, "ann")
    assert link.kinds == ["stop", "release", "stop"]
    assert [line["by"] for line in link.sent] == ["ben", "ann", "ben"]
    assert not world.robot.stops.releases


async def test_only_the_answer_to_a_release_ends_it(world):
    """A status that answers nothing, or something else, says nothing of it; two may release a robot at once.

    Nobody reads meanwhile that the robot is stopped and that its guard does not have it.
    """
    link = world.online()
    world.stops.stop(SIM1, "ben")
    releases = [asyncio.create_task(world.stops.release(SIM1, by)) for by in ("ann", "carl")]
    await until(lambda: link.kinds.count("release") == 2, "both are on their way")
    for answers in (None, "another"):
        world.registry.on_guard_status(link, GuardReport("ready"), answers)
    await asyncio.sleep(0)
    assert not any(release.done() for release in releases)
    for line, release in zip(link.sent[1:], releases, strict=True):
        world.registry.on_guard_status(link, GuardReport("ready"), line["id"])
        assert world.stops.of(SIM1.id) is None
        await release


async def test_a_robot_that_is_gone_leaves_nothing(world):
    world.online()
    for robot in (SIM1, SIM2):
        world.stops.stop(robot, "ben")
    stops = world.robot.stops
    assert stops.repeat_timer is not None
    world.robot.links.clear()
    world.registry.on_snapshot(Snapshot({SIM2.id: SIM2}, {}))
    assert (world.stops.of(SIM1.id), world.stops.of(SIM2.id).by) == (None, "ben")
    assert stops.repeat_timer is None


async def test_a_stop_of_another_cell_is_sent_and_written_once(world):
    """That cell may end before it has written it; it comes again with each connection of cells."""
    link, stop = world.online(), Stop(SIM1.id, NOON, "ben", "smoke")
    for _ in range(2):
        world.stops.learn(stop)
    assert [line["by"] for line in link.sent] == ["ben"]
    assert world.revoked == [(SIM1.id, close_reasons.robot_stopped("sim1", "ben", NOON))]
    assert world.changed == [SIM1.id]
    assert world.written == [StopEntry(SIM1.id, stop)]


async def test_what_came_last_is_shown_whenever_it_began(world):
    """Who releases the robot has seen that one."""
    world.online("off")
    world.stops.learn(Stop(SIM1.id, NOON, "ann"))
    world.stops.learn(Stop(SIM1.id, NOON - timedelta(hours=1), "ben"))
    assert world.stops.shown(SIM1.id) == ShownStop("ben", "2026-01-01T11:00:00Z")
    with pytest.raises(NotPossibleError):
        await world.stops.release(SIM1, "ann", seen=ShownStop("ann", "2026-01-01T12:00:00Z"))
    await world.stops.release(SIM1, "ann", seen=world.stops.shown(SIM1.id))
    assert world.stops.of(SIM1.id) is None


async def test_a_release_ends_all_stops_that_were_here_and_writes_which(world):
    world.online("off")
    stops = [Stop(SIM1.id, NOON, "ann"), Stop(SIM1.id, NOON, "ben")]
    for stop in stops:
        world.stops.learn(stop)
    await world.stops.release(SIM1, "carl")
    assert world.written[-2].ended == tuple(stop.id for stop in stops)
    for stop in stops:
        world.stops.learn(stop)
    assert world.stops.of(SIM1.id) is None


@pytest.mark.parametrize("is_answered", [False, True])
@pytest.mark.parametrize("begins_elsewhere", [False, True])
async def test_a_stop_during_a_release_wins(world, is_answered, begins_elsewhere):
    """The guard gets it behind the release, also if it had answered that before anybody heard of it."""
    link = world.online()
    world.stops.stop(SIM1, "ann")
    release = await world.releasing(link)
    if is_answered:
        world.registry.on_guard_status(link, GuardReport("ready"), link.sent[-1]["id"])
    if begins_elsewhere:
        world.stops.learn(Stop(SIM1.id, NOON, "ben"))
    else:
        world.stops.stop(SIM1, "ben")
    with pytest.raises(NotPossibleError, match="ben has stopped it again"):
        await release
    assert world.stops.of(SIM1.id).by == "ben"
    assert link.kinds == ["stop", "release", "stop"]


async def test_a_release_that_is_given_up_leaves_a_stop_that_is_repeated(world, monkeypatch):
    """Who asked went away, and nobody knows what the guard did."""
    monkeypatch.setattr(stops_module, "REPEAT_EVERY_S", 0.01)
    link = world.online()
    world.stops.stop(SIM1, "ben")
    release = asyncio.create_task(world.stops.release(SIM1, "ann"))
    await until(lambda: world.robot.stops.repeat_timer is None, "the time to repeat it passes")
    release.cancel()
    await asyncio.gather(release, return_exceptions=True)
    await until(lambda: "stop" in link.kinds[link.kinds.index("release") :], "it is sent again")


async def test_who_stops_without_end_fills_neither_the_session_nor_the_log(world):
    """A session that is full would end, and the robot were offline; each counts once in a while."""
    link = world.online()

    def insist():
        for _ in range(500):
            world.stops.stop(SIM1, "eve")
            world.stops.stop(SIM1, "mallory")

    insist()
    release = await world.releasing(link)
    insist()
    with pytest.raises(NotPossibleError):
        await release
    assert len(link.sent) < 10
    assert link.kinds[-1] == "stop"
    assert [entry.actor for entry in world.audit] == ["eve", "mallory", "eve"]


async def test_a_release_lets_all_begin_anew(world):
    """Else the second of two stops after it would be taken for a press of before."""
    world.online("off")
    for _ in range(2):
        world.stops.stop(SIM1, "eve")
        world.stops.stop(SIM1, "mallory")
        assert world.stops.of(SIM1.id).by == "mallory"
        await world.stops.release(SIM1, "ann")


async def test_another_persons_stop_takes_the_place_of_the_first(world):
    """The guard gets the newest name, the log has both, and the stop stays confirmed."""
    link = world.online()
    world.stops.stop(SIM1, "ann")
    world.registry.on_guard_status(link, STOPPED, None)
    world.stops.stop(SIM1, "ben")
    assert world.stops.of(SIM1.id).by == "ben"
    assert world.stops.confirmed(SIM1.id)
    assert [line["by"] for line in link.sent] == ["ann", "ben"]
    assert [entry.actor for entry in world.audit] == ["ann", "ben"]


async def test_one_press_on_two_ways_does_not_hide_a_stop_between_them(world, monkeypatch):
    """Ann's page tells its stop twice, and Ben's came meanwhile; later she means another one."""
    for name in ("ann", "ben", "ann", "ben", "ann"):
        world.stops.stop(SIM1, name)
    assert world.stops.of(SIM1.id).by == "ben"
    monkeypatch.setattr(stops_module, "SAME_PRESS_S", 0.0)
    world.stops.stop(SIM1, "ann")
    assert world.stops.of(SIM1.id).by == "ann"


async def test_a_press_that_comes_late_on_its_second_way_undoes_no_release(world):
    """Not even one that is under way; another person's press of that id, and the next of this one, are stops."""
    link = world.online()
    world.stops.stop(SIM1, "ann", press="1")
    release = await world.releasing(link)
    world.stops.stop(SIM1, "ann", press="1")
    world.registry.on_guard_status(link, GuardReport("ready"), link.sent[-1]["id"])
    await release
    world.stops.stop(SIM1, "ann", press="1")
    assert world.stops.of(SIM1.id) is None
    for by, press in (("ben", "1"), ("ann", "2")):
        world.stops.stop(SIM1, by, press=press)
        assert world.stops.of(SIM1.id).by == by
    world.stops.stop(SIM2, "ann", press="2")
    assert world.stops.of(SIM2.id) is not None, "the press was another robot's"
    for number in range(2 * MAX_STOPS):
        world.stops.learn_end(SIM2.id, world.stops.of(SIM2.id).id)
        world.stops.stop(SIM2, "ann", press=f"more {number}")
        assert world.stops.of(SIM2.id) is not None, "however many are remembered"


async def test_a_reason_of_its_own_makes_another_stop(world):
    """The log has each reason that the server confirmed; the same press without one adds nothing."""
    world.online()
    for reason in ("smoke", "smoke", None, "fire"):
        world.stops.stop(SIM1, "ann", reason=reason)
    assert world.stops.of(SIM1.id).reason == "fire"
    assert [entry.details for entry in world.audit] == [{"reason": "smoke"}, {"reason": "fire"}]


async def test_a_release_ends_the_stop_that_was_seen_and_no_other(world):
    world.online("off")
    world.stops.stop(SIM1, "ann")
    seen = world.stops.shown(SIM1.id)
    world.stops.stop(SIM1, "ben")
    newer = world.stops.shown(SIM1.id)
    why = r"^ben stopped sim1 at \d\d:\d\d UTC too; check again"
    for other in (seen, ShownStop(newer.by, "2026-01-01T12:00:00Z")):
        with pytest.raises(NotPossibleError, match=why):
            await world.stops.release(SIM1, "ann", seen=other)
        assert world.stops.of(SIM1.id).by == "ben"
    for _ in range(2):
        await world.stops.release(SIM1, "ann", seen=newer)
        assert world.stops.of(SIM1.id) is None


async def test_a_release_at_another_cell_ends_what_it_names(world, monkeypatch):
    """Whatever is left is sent to the guard that confirmed the release; what was not known here never begins."""
    monkeypatch.setattr(stops_module, "REPEAT_EVERY_S", 0.01)
    link = world.online()
    ann, ben = Stop(SIM1.id, NOON, "ann"), Stop(SIM1.id, NOON, "ben")
    for stop in (ann, ben):
        world.stops.learn(stop)
    link.sent.clear()
    world.stops.learn_end(SIM1.id, ben.id)
    assert world.stops.of(SIM1.id) == ann
    assert world.written[-1] == StopEntry(SIM1.id, ann)
    await until(lambda: [line["by"] for line in link.sent][:1] == ["ann"], "the guard has it")
    world.stops.learn_end(SIM1.id, ann.id)
    world.stops.learn_end(SIM1.id, (NOON, "carl"))
    world.stops.learn(Stop(SIM1.id, NOON, "carl"))
    assert world.stops.of(SIM1.id) is None


async def test_a_robot_that_came_here_stopped_stays_so_when_the_stop_ended_elsewhere(world):
    """The cell that released it could not report that, and this one has stopped it again: it shows so."""
    stop = Stop(SIM1.id, NOON, "ben")
    world.stops.learn(stop)
    link = world.online()
    world.registry.on_guard_status(link, STOPPED, None)
    world.stops.learn_end(SIM1.id, stop.id)
    assert world.stops.shown(SIM1.id).by == "somebody at the robot (ben)"
    assert world.stops.close_reason(SIM1) is not None


async def test_who_stops_a_robot_once_more_that_is_not_here_makes_a_new_stop(world):
    """Another cell may have released it, and only what is new reaches that one when the two are cut off."""
    world.stops.learn(Stop(SIM1.id, NOON, "ben"))
    world.written.clear()
    for _ in range(2):
        world.stops.stop(SIM1, "ben")
    with pytest.raises(ConnectionClosedError):
        await world.stops.release(SIM1, "ann")
    newest = world.stops.of(SIM1.id)
    assert newest.at > NOON
    assert [entry.stop for entry in world.written if isinstance(entry, StopEntry)] == [newest]


async def test_stops_of_a_robot_are_bounded(world):
    for minute in range(50):
        world.stops.learn(Stop(SIM1.id, NOON + timedelta(minutes=minute), "ben"))
    known = world.robot.stops
    assert len(known.in_force) == MAX_STOPS
    assert world.stops.of(SIM1.id).at == NOON + timedelta(minutes=49)
    for minute in range(50):
        world.stops.learn_end(SIM1.id, (NOON + timedelta(minutes=minute), "ben"))
    assert (len(known.ended), known.entry.stop) == (MAX_STOPS, None)


async def test_what_ended_long_ago_takes_no_room_of_what_ended_last(world):
    """A cell that was cut off tells all that it remembers, and has the last stop still in force."""
    last = Stop(SIM1.id, NOON + timedelta(hours=1), "ben")
    old = [(NOON + timedelta(minutes=minute), "ben") for minute in range(40)]
    for stop_id in [*old, last.id, *old[:MAX_STOPS]]:
        world.stops.learn_end(SIM1.id, stop_id)
    world.stops.learn(last)
    assert world.stops.of(SIM1.id) is None


@pytest.mark.parametrize("seed", range(20))
async def test_cells_agree_on_stops_whatever_reaches_whom(seed):
    """What no release knew stays in force everywhere, and nothing else; the robot is at the first cell."""
    chance, cells = random.Random(seed), [World() for _ in range(3)]
    cells[0].online("off")
    begun = set()
    ended = set()

    def report(to, of):
        known = of.robot.stops
        for stop_id in list(known.ended) if known else ():
            to.stops.learn_end(SIM1.id, stop_id)
        for stop in list(known.in_force.values()) if known else ():
            to.stops.learn(stop)

    for _ in range(60):
        cell, other = chance.sample(cells, 2)
        if chance.random() < 0.4:
            cell.stops.stop(SIM1, chance.choice(["ann", "ben", "carl"]))
            begun.add(cell.stops.of(SIM1.id).id)
        elif chance.random() < 0.7:
            report(cell, other)
        else:
            known = cells[0].robot.stops
            ended.update(known.in_force if known else ())
            await cells[0].stops.release(SIM1, "ann")
    for _ in cells:
        for cell, other in itertools.permutations(cells, 2):
            report(cell, other)
    for cell in cells:
        assert set(cell.robot.stops.in_force) == begun - ended
        cell.registry.close()
