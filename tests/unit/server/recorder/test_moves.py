"""What is known of a recording whose robot, relay or recorder is lost: two recorders, one real database."""

import asyncio
import time
from types import SimpleNamespace

import pytest
from granted import give
from recorded_drive import own_message
from relay_server import MESSAGE_LIMIT, TICKET_KEY
from robotether_server.db import recordings, robots, users
from robotether_server.db.recordings import Progress
from robotether_server.lerobot.recording import RecordedControl, read_recording
from robotether_server.recorder import service
from robotether_server.recorder.channels import UNKNOWN_CONTROL
from robotether_server.recorder.mcap_file import McapFile
from robotether_server.recorder.robot_recorder import path_of
from robotether_server.recorder.service import RecorderService
from robotether_server.recorder.store import RecorderStore
from robotether_server.services import recordings as recording_service
from robotether_server.settings.server import DatabaseSettings, RecorderSettings, TicketSettings
from web_visitor import HASH

STAMP = {"stamp": {"sec": 1, "nanosec": 2}}
HERE = {**UNKNOWN_CONTROL, **STAMP, "online": True, "driver": "ann", "fence": 3}
DRIVERS = [f"driver{number}-{'x' * 50}" for number in range(8)]
AWAY = {**UNKNOWN_CONTROL, **STAMP, "fence": 0}


class RecorderOfCell:
    """The recorder of a cell, without a relay, whose events a test makes."""

    def __init__(self, cell, folder, database, robot_id):
        self.folder, self.robot_id = folder / cell, robot_id
        self.folder.mkdir()
        nowhere = DatabaseSettings("nowhere", 1, "none", "none", "none")
        tickets = TicketSettings(TICKET_KEY, 30)
        limits = (10**9, 0, MESSAGE_LIMIT, "info")
        settings = RecorderSettings(nowhere, tickets, cell, "127.0.0.1", self.folder, *limits)

        async def refuse(*_):
            raise OSError

        client = SimpleNamespace(open_rosbridge=refuse, open_frames=refuse)
        self._start = lambda: RecorderService(settings, client, RecorderStore(database, cell))
        self.service = self._start()

    async def restart_killed(self):
        """Start the recorder again that was killed, and let it repair its files."""
        for recorder, _, _ in self.service._open.values():
            recorder.flush()
            for recording in recorder.recordings.values():
                recording.file.close()
            if recorder._observing is not None:
                recorder._observing.cancel()
        self.service = self._start()
        await self.service.step()
        await asyncio.gather(*self.service.repairs)

    async def report(self, control):
        """Have its relay say this of the robot, and take a step before and after."""
        await self.service.step()
        self.service.on_event(self.robot_id, "control", control)
        await self.service.step()

    def controls(self, number):
        """Who drove by a file that ended, in the order of their times; None: unknown."""
        read = read_recording(path_of(self.folder, number))
        controls = [each for each in read if isinstance(each, RecordedControl)]
        assert controls == sorted(controls, key=lambda control: control.at_ns)
        return [None if each.fence < 0 else each.is_driven for each in controls]


@pytest.fixture
def robot_id(database, admin_database):
    with admin_database.transaction() as tx:
        number = robots.add(tx, "02:00:00:00:00:01", "sim1")
        tx.change("UPDATE robots SET state = 'active'")
    with database.transaction() as tx:
        give(tx, users.add(tx, "ann", HASH, "user"), number, "drive")
    return number


def ask(database, robot_id):
    with database.transaction() as tx:
        return recordings.ask(tx, robot_id, "sim1", users.get(tx, "ann"))


def rows(database):
    with database.transaction() as tx:
        read = tx.rows("SELECT cause, asked_by, cell, end_code FROM recordings ORDER BY id")
        return [tuple(row.values()) for row in read]


@pytest.fixture
def cells(tmp_path, recorder_database, robot_id):
    return [RecorderOfCell(cell, tmp_path, recorder_database, robot_id) for cell in ("a", "b")]


async def test_an_asked_recording_goes_on_where_the_robot_goes(
    cells, database, robot_id, admin_database
):
    """It ends after the time that one may last in all, at whichever machines."""
    here, there = cells
    number = ask(database, robot_id)
    await there.report(AWAY)
    await here.report(HERE)
    assert rows(database) == [("asked", "ann", "a", None)]
    await here.report({**AWAY, "elsewhere": True})
    assert rows(database) == [("asked", "ann", "a", "robot_moved"), ("asked", "ann", None, None)]
    await there.report(HERE)
    assert rows(database)[1:] == [("asked", "ann", "b", None)]
    assert here.controls(number) == [True, None]
    with database.transaction() as tx:
        # By the number of before.
        assert recording_service.stop(tx, users.get(tx, "ann"), number).id == number + 1
    with admin_database.transaction() as tx:
        tx.change(
            "UPDATE recordings SET first_asked_at = asked_at - INTERVAL 3 HOUR, stop_requested_at = NULL"
            " WHERE id > %s",
            (number,),
        )
    there.service.on_event(robot_id, "control", {**AWAY, "elsewhere": True})
    await there.service.step()
    assert [row[3] for row in rows(database)] == ["robot_moved", "robot_moved", None]
    with admin_database.transaction() as tx:
        tx.change("UPDATE recordings SET first_asked_at = first_asked_at - INTERVAL 1 HOUR")
    await here.report(HERE)
    await here.service.step()
    assert rows(database)[2] == ("asked", "ann", "a", "too_long")


@pytest.mark.parametrize(
    ("code", "name"),
    [("robot_renamed", "rover"), ("recorder_stopped", "sim1"), ("recorder_restarted", "sim1")],
)
async def test_an_asked_recording_goes_on_after_a_rename_or_a_restart(
    *, cells, database, robot_id, admin_database, code, name
):
    number = ask(database, robot_id)
    await cells[0].report(HERE)
    with admin_database.transaction() as tx:
        tx.change("UPDATE robots SET name = %s", (name,))
    if code == "recorder_stopped":
        await cells[0].service.close()
    elif code == "recorder_restarted":
        await cells[0].restart_killed()
    for _ in range(2):
        await cells[0].report(HERE)
    assert rows(database) == [("asked", "ann", "a", code), ("asked", "ann", "a", None)]
    with database.transaction() as tx:
        later = recording_service.stop(tx, users.get(tx, "ann"), number)
    assert (later.id, later.robot) == (number + 1, name)
    await cells[0].service.step()


@pytest.mark.parametrize("ago", ["0 HOUR", "4 HOUR"])
async def test_what_a_killed_recorder_recorded_goes_on_once_and_not_for_ever(
    *, cells, database, robot_id, admin_database, ago
):
    """Nobody's page says that it goes on while the recorder is away, so somebody asks again."""
    number = ask(database, robot_id)
    await cells[0].report(HERE)
    if ago == "0 HOUR":
        ask(database, robot_id)
    with admin_database.transaction() as tx:
        tx.change(
            f"UPDATE recordings SET asked_at = asked_at - INTERVAL {ago} WHERE id = %s", (number,)
        )
    await cells[0].restart_killed()
    for _ in range(2):
        await cells[0].report(HERE)
    codes = ["recorder_restarted"] + [None] * (ago == "0 HOUR")
    assert [row[3] for row in rows(database)] == codes
    await cells[0].service.close()


async def test_a_robot_that_moved_is_not_recorded_here_by_its_settings(
    cells, database, admin_database
):
    with admin_database.transaction() as tx:
        tx.change("""UPDATE robots SET settings = '{"recording": {"when": "always"}}'""")
    await cells[0].report(HERE)
    await cells[0].report({**AWAY, "elsewhere": True})
    await cells[0].service.step()
    assert rows(database) == [("always", None, "a", "robot_moved")]


async def test_who_drives_is_unknown_while_the_relay_is_away(cells, database, robot_id):
    number = ask(database, robot_id)
    recorder = cells[0]
    await recorder.report(HERE)
    recorder.service.on_lost(STAMP["stamp"]["nanosec"])
    await recorder.report(HERE)
    with database.transaction() as tx:
        recordings.request_stop(tx, number)
    await recorder.service.step()
    assert recorder.controls(number) == [True, None, True]


async def test_nothing_begins_on_what_a_lost_relay_last_said(
    cells, database, robot_id, admin_database, monkeypatch
):
    monkeypatch.setattr(service, "OFFLINE_S", 0.0)
    with admin_database.transaction() as tx:
        tx.change("""UPDATE robots SET settings = '{"recording": {"when": "always"}}'""")
    recorder = cells[0]
    await recorder.report(HERE)
    recorder.service.on_lost(0)
    ask(database, robot_id)
    for _ in range(2):
        await asyncio.sleep(0.01)
        await recorder.service.step()
    assert rows(database) == [("always", None, "a", "relay_away"), ("asked", "ann", None, None)]


@pytest.mark.parametrize("is_removed", [False, True])
@pytest.mark.parametrize(("chunks", "lasted_s"), [(1, 3600), (0, 1800)])
async def test_of_a_killed_recorder_nothing_is_made_up(
    *, cells, recorder_database, database, robot_id, admin_database, chunks, lasted_s, is_removed
):
    """Its record names who drove, and does not last until somebody starts the recorder again.

    So it is where the machine was removed, and is back.
    """
    number, store = ask(database, robot_id), RecorderStore(recorder_database, "a")
    [row], [robot] = await store.read()
    assert await store.begin(row, robot)
    await store.write_progress({number: Progress(1, 1, DRIVERS)})
    file = McapFile(path_of(cells[0].folder, number))
    for _ in range(chunks):
        file.add(own_message("control", HERE, 0)._replace(log_ns=time.time_ns()))
        file.end_chunk()
    file.close()
    with admin_database.transaction() as tx:
        tx.change(
            "UPDATE recordings SET started_at = CURRENT_TIMESTAMP(6) - INTERVAL 1 HOUR,"
            " progress_at = CURRENT_TIMESTAMP(6) - INTERVAL 30 MINUTE"
        )
        if is_removed:
            tx.change("CALL remove_cell('a')")
    again = cells[0].service
    await again.step()
    await asyncio.gather(*again.repairs)
    await again.step()
    with database.transaction() as tx:
        ended = recordings.get(tx, users.get(tx, "ann"), "drive", number)
    assert (ended.end_code, ended.drivers) == ("recorder_restarted", DRIVERS)
    assert ended.messages == chunks
    assert ended.lasted_s == pytest.approx(lasted_s, abs=30)
