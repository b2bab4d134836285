"""Polling for changes, with records that come and go."""

import pytest
from relay_server import ANN, utc
from robotether_server.relay.records.fleet import Fleet


class Heard:
    def __init__(self):
        self.snapshots = []
        self.rechecks = 0
        self.checks_of_new = 0

    async def recheck(self, *, changed):
        self.rechecks += changed

    async def check_new(self):
        self.checks_of_new += 1


@pytest.fixture
def heard():
    return Heard()


@pytest.fixture
def fleet(memory_database, heard):
    fleet = Fleet(memory_database, heard)
    fleet.listen(heard.snapshots.append)
    return fleet


async def test_the_fleet_is_read_when_it_changed_and_only_then(fleet, memory_database, heard):
    """A new login is no change of it; new credentials are looked at each time: what changed may have ended them."""
    restored = []
    fleet.restore_last_seen = restored.append
    fleet.restore_control = lambda _: restored.append("control")
    memory_database.seen = [(7, utc(2026, 1, 1), None)]
    await fleet.poll()
    await fleet.poll()
    assert (len(heard.snapshots), heard.rechecks, heard.checks_of_new) == (1, 1, 1)
    memory_database.add_credential("login", ANN)
    await fleet.poll()
    assert (len(heard.snapshots), heard.rechecks, heard.checks_of_new) == (1, 2, 1)
    memory_database.add_robot(8, "sim2")
    await fleet.poll()
    assert [sorted(snapshot.robots) for snapshot in heard.snapshots] == [[7], [7, 8]]
    assert fleet.snapshot() is heard.snapshots[1]
    assert restored == [[(7, utc(2026, 1, 1), None)], "control"]


async def test_an_outage_keeps_the_last_snapshot_and_is_logged_once(fleet, memory_database, caplog):
    await fleet.poll()
    for is_down in (True, True, False, False):
        memory_database.down = is_down
        await fleet.poll()
        assert (sorted(fleet.snapshot().robots), fleet.store_up) == ([7], not is_down)
    assert len(caplog.records) == 2
