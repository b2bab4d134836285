"""robotether robot add, list, show, remove, wait-online."""

import json

import pytest
from admin_records import ADD, activate, claim
from dated_certificate import make_certificate
from tls_web import running


def test_show_tells_all_of_one_robot(run, database, admin_database):
    assert "cannot find robot sim1" in run("robot", "show", "sim1").err
    run(*ADD)
    assert "never seen" in run("robot", "show", "sim1").out
    run("robot", "set", "sim1", "recording.when=driven")
    activate(database)
    claim(database)
    with admin_database.transaction() as tx:
        tx.change(
            "INSERT INTO robot_sessions (robot_id, address, agent_version) "
            "SELECT id, '198.51.100.7', '0.2.0' FROM robots"
        )
    shown = run("robot", "show", "sim1").out
    for text in (
        "sim1 (active)",
        "SHA256:abc",
        "SHA256:other",
        "MAC is in use",
        "ongoing",
        "driven",
    ):
        assert text in shown
    whole = json.loads(run("robot", "show", "sim1", "--json").out)
    assert (whole["address"], whole["agent_version"]) == ("198.51.100.7", "0.2.0")
    assert [item["reason"] for item in whole["waiting"]] == ["mac_in_use"]
    assert [session["ended_at"] for session in whole["sessions"]] == [None]
    # Also in a table: the zone of the person who reads it may be another.
    assert " UTC  " in run("robot", "list").out


def test_wait_online(run, admin_database):
    run(*ADD)
    done = run("robot", "wait-online", "sim1", "--timeout", "0")
    assert done.status == 1
    assert "cannot see robot sim1 online after 0 s" in done.err
    with admin_database.transaction() as tx:
        tx.change("INSERT INTO robot_sessions (robot_id, address) SELECT id, '' FROM robots")
    assert run("robot", "wait-online", "sim1").out == "robot sim1 is online\n"
    assert run("robot", "list").out.splitlines()[1].split()[2] == "yes"


STOP = {"by": "ann", "at": "2026-01-01T12:00:00Z"}
CONTROL = {"driver": None, "waiting": None, "reserved": None, "guard": "ok"}


@pytest.mark.parametrize(
    ("status", "answer", "words"),
    [
        ("200 OK", CONTROL | {"stopped": STOP | {"confirmed": True}}, ""),
        ("200 OK", CONTROL | {"stopped": STOP | {"confirmed": False}}, "may still move"),
        ("200 OK", CONTROL | {"stopped": None}, "is not stopped"),
        ("403 Forbidden", {"detail": "cannot stop it: no grant"}, "no grant"),
        ("502 Bad Gateway", "<html>", "nothing confirms"),
    ],
)
def test_stop_succeeds_only_when_the_guard_confirms_it(
    run, monkeypatch, tmp_path, *, status, answer, words
):
    asked = []

    def site(environ, respond):
        asked.append(
            (environ["PATH_INFO"], environ["HTTP_AUTHORIZATION"], environ["wsgi.input"].read(18))
        )
        respond(status, [])
        return [json.dumps(answer).encode()]

    certificate = make_certificate(tmp_path)
    monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
    monkeypatch.setenv("ROBOTETHER_TOKEN", "rt_of_ann")
    with running(site, None, certificate) as web:
        done = run("stop", "sim1", "--host", web.address, "--reason", "smoke")
    assert asked == [("/api/v1/robots/sim1/stop", "Bearer rt_of_ann", b'{"reason":"smoke"}')]
    assert (done.status == 0) is ("has confirmed it" in done.out) is (words == "")
    assert words in done.err
    gone = run("stop", "sim1", "--host", web.address)
    assert gone.status == 1
    assert "nothing confirms" in gone.err


def test_stop_reads_a_token_from_a_file_with_lines_and_shows_no_other(run, monkeypatch, tmp_path):
    tokens = []

    def site(environ, respond):
        tokens.append(environ["HTTP_AUTHORIZATION"])
        respond("403 Forbidden", [])
        return [b"{}"]

    certificate = make_certificate(tmp_path)
    monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
    with running(site, None, certificate) as web:
        for token in ("rt_of_ann\r\n", "rt_of\nann", "rt_of_\u20ac"):
            monkeypatch.setenv("ROBOTETHER_TOKEN", token)
            done = run("stop", "sim1", "--host", web.address)
            assert "nothing confirms" in done.err
            assert "rt_of" not in done.err
        monkeypatch.delenv("SSL_CERT_FILE")
        monkeypatch.setenv("ROBOTETHER_TOKEN", "rt_of_ann")
        assert "SSL_CERT_FILE can name" in run("stop", "sim1", "--host", web.address).err
    assert tokens == ["Bearer rt_of_ann"]
