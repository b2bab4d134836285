"""What the recorder writes into the real database, also when that is away at times."""

from relay_server import cell_settings
from robotether_server.db import cells, recordings, users
from robotether_server.db.recordings import Progress, RecordableRobot
from robotether_server.problems import StoreUnavailableError
from robotether_server.recorder.store import RecorderStore, RecordingEnd
from robotether_server.times import utc_now


async def test_no_end_is_lost_while_the_database_is_away(
    recorder_database, admin_database, monkeypatch
):
    """It goes away between two of them: neither is written, and later each is, once."""
    store = RecorderStore(recorder_database, "main")
    robot = RecordableRobot(7, "sim1")
    numbers = [await store.add(robot, "always", utc_now()) for _ in range(2)]
    assert await store.read_present({*numbers, 0}) == set(numbers)
    assert await RecorderStore(recorder_database, "other").read_present({*numbers}) == set()
    for number in numbers:
        store.end(RecordingEnd(number, "sim1", "recorder", "robot_offline", None, utc_now()))
    write_end = recordings.end

    def end(tx, recording_id, *fields):
        if recording_id == numbers[1]:
            raise StoreUnavailableError("it is away")
        write_end(tx, recording_id, *fields)

    monkeypatch.setattr(recordings, "end", end)
    assert await store.read() is None
    monkeypatch.undo()
    assert await store.read() == ([], [])
    with admin_database.transaction() as tx:
        lines = tx.rows(
            "SELECT JSON_VALUE(details, '$.recording') AS recording FROM audit_events"
            " WHERE kind = 'recording_ended' ORDER BY id"
        )
    assert [line["recording"] for line in lines] == [str(number) for number in numbers]


async def test_a_recorder_deletes_what_no_other_one_will(
    recorder_database, relay_database, database
):
    """Nobody else deletes the record of what never began, and what a removed machine recorded."""
    with relay_database.transaction() as tx:
        for name in ("here", "there"):
            cells.write_heartbeat(tx, cell_settings(name), cells.CellCounts(), utc_now())
    numbers = {}
    for cell in ("here", "there", "removed"):
        store = RecorderStore(recorder_database, cell)
        numbers[cell] = await store.add(RecordableRobot(7, "sim1"), "always", utc_now())
    with database.transaction() as tx:
        users.add(tx, "ann", "x", "user")
        numbers["never begun"] = recordings.ask(tx, 7, "sim1", users.get(tx, "ann"))
    for number in numbers.values():
        store.end(RecordingEnd(number, "sim1", "recorder", "robot_offline", None, utc_now()))
    await store.flush()
    older = await RecorderStore(recorder_database, "here").read_older(utc_now())
    assert {*older} == {number for cell, number in numbers.items() if cell != "there"}


async def test_the_recordings_of_a_sites_other_machines_are_summed(
    recorder_database, relay_database
):
    """A machine that was removed has none any more, nor has one whose file is deleted."""
    with relay_database.transaction() as tx:
        for name in ("here", "there"):
            cells.write_heartbeat(tx, cell_settings(name), cells.CellCounts(), utc_now())
    sizes = {"here": 1, "there": 20, "removed": 300}
    for cell, size in sizes.items():
        store = RecorderStore(recorder_database, cell)
        number, deleted = [
            await store.add(RecordableRobot(7, "sim1"), "always", utc_now()) for _ in range(2)
        ]
        await store.write_progress({number: Progress(size, 1), deleted: Progress(4000, 1)})
        await store.note_deleted(deleted)
    assert await RecorderStore(recorder_database, "here").read_bytes_elsewhere(0) == 20
