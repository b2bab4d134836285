"""How the site is, for admins alone: what cannot be known here is unknown, and nothing else."""

import datetime as dt
import socket
import time
from dataclasses import replace
from threading import Thread

import pytest
from relay_server import cell_settings
from robotether_server.db import cells
from robotether_server.problems import HistoryUnavailableError
from robotether_server.services.health import SshProbe
from robotether_server.services.history import FiringAlert, Prometheus

NOON = dt.datetime(2026, 1, 1, 12, 0, tzinfo=dt.UTC)


class AbsentPrometheus(Prometheus):
    def _ask(self, path, query, member="result"):
        raise HistoryUnavailableError("cannot read the history: the test has none")


class FakePrometheus(Prometheus):
    def alerts(self):
        return [FiringAlert("DiskFull", "5% are free")]


@pytest.fixture
def use(app):
    """Gives the application parts of the tests."""

    def use(**parts):
        app.extensions["robotether"] = replace(app.extensions["robotether"], **parts)

    use(prometheus=AbsentPrometheus(("nobody", 1)))
    return use


def states(root):
    health = root.ask("GET", "/health").json
    return {part["name"]: part["state"] for part in health["parts"]}, health["alerts"]


def test_without_prometheus_alerts_are_unknown(root, use):
    parts, alerts = states(root)
    assert (parts["web"], parts["database"]) == ("good", "good")
    assert {parts[name] for name in ("prometheus", "sshd")} == {"unknown"}
    assert alerts is None
    use(prometheus=FakePrometheus(("nobody", 1)))
    parts, alerts = states(root)
    assert parts["prometheus"] == "good"
    assert alerts == [{"name": "DiskFull", "summary": "5% are free"}]


def test_disks_and_recorder_of_each_cell_are_judged(
    root, use, relay_database, recorder_database, admin_database
):
    """What nobody says is unknown, as is what was said by a relay that is silent now, or an older version's now."""
    said = {
        "a": {"disk_free": 0.5, "recorders": 1},
        "b": {"disk_free": 0.05, "recorders": 0},
        "c": {},
        "dead": {"disk_free": 0.5, "recorders": 1},
        "older": {"disk_free": 0.5, "recorders": 1},
    }
    with relay_database.transaction() as tx:
        for name, counts in said.items():
            cells.write_heartbeat(tx, cell_settings(name), cells.CellCounts(**counts), NOON)
    with recorder_database.transaction() as tx:
        for name, free in {"a": 0.5, "b": 0.05, "dead": 0.5, "older": 0.5}.items():
            cells.write_recordings_free(tx, name, free)
    with admin_database.transaction() as tx:
        tx.change("UPDATE cells SET heartbeat_at = CURRENT_TIMESTAMP(6) WHERE name = 'older'")
        tx.change("UPDATE cells SET heartbeat_at = %s WHERE name = 'dead'", (NOON,))
        tx.change(
            "UPDATE cells SET recordings_counted_at = %s WHERE name IN ('dead', 'older')", (NOON,)
        )
    parts, _ = states(root)
    expected = {"a": "good", "b": "bad"} | dict.fromkeys(("c", "dead", "older"), "unknown")
    for name, state in expected.items():
        kinds = ("recorder", "disk", "recordings")
        assert {parts[f"{kind} of {name}"] for kind in kinds} == {state}, name


def test_disk_of_the_database_is_judged_where_it_is_recorded(root, use, tmp_path):
    use(database_record=tmp_path / "database")
    for record, state in (("5 95\n8:1\n", "bad"), ("50 50\n", "good"), ("?", "unknown")):
        (tmp_path / "database").write_text(record)
        assert states(root)[0]["disk of the database"] == state


@pytest.mark.parametrize(("age_s", "state"), [(3600, "good"), (200_000, "bad"), (-3600, "unknown")])
def test_a_backup_is_good_for_a_day_and_never_with_a_date_in_the_future(
    root, use, tmp_path, age_s, state
):
    (tmp_path / "made").write_text(f"{time.time() - age_s:.0f}")
    use(backup_record=tmp_path)
    assert states(root)[0]["backups"] == state


@pytest.mark.parametrize(
    ("line", "answers"),
    [(b"SSH-2.0-OpenSSH_10.0\r\n", True), (b"HTTP/1.1 400 Bad Request\r\n", None), (b"", False)],
)
def test_sshd_is_asked_through_nginx(line, answers):
    """What is there and says nothing is an nginx that does not reach it."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            connection, _ = server.accept()
            with connection:
                connection.recv(64)
                connection.sendall(line)

        thread = Thread(target=serve)
        thread.start()
        probe = SshProbe(server.getsockname())
        assert probe.answers() is answers
        thread.join()
    # Kept, as nobody is there any more.
    assert probe.answers() is answers
