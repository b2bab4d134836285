"""robotether audit."""

import re

from admin_records import ADD
from robotether_common.audit_head import NAMESPACE, statement
from robotether_server.audit_chain import server_key
from robotether_server.db import audit, audit_chains
from robotether_server.db.audit import Source
from robotether_server.signatures import SigningKey, fingerprint


def test_log_is_verified_and_the_first_line_that_does_not_fit_is_named(
    run, admin_database, tmp_path
):
    """That holds for the database and an exported file; a line's end in a name feigns no line of its own."""
    file = tmp_path / "export"
    run(*ADD)
    run("user", "add", "ann")
    with admin_database.transaction() as tx:
        audit.record(tx, Source("x\nsim1: all fits"), "login_failed", note="a\n{}")
        audit.record(tx, Source("ann"), "robot_stopped", "sim1")
    file.write_text(run("audit", "export").out)
    done = run("audit", "verify")
    assert (done.status, done.err) == (0, "")
    outside, sim1 = done.out.splitlines()
    assert outside.startswith("lines without a robot: ")
    assert re.fullmatch("sim1: 2 lines fit; .*not signed by the robot", sim1)
    assert run("audit", "verify", file) == done
    with admin_database.transaction() as tx:
        tx.change("UPDATE audit_events SET actor = 'ben' WHERE kind = 'robot_stopped'")
    file.write_text(run("audit", "export").out)
    for options in ((), (file,)):
        done = run("audit", "verify", *options)
        assert (done.status, "sim1: line 2 of" in done.err) == (1, True)
    file.write_text('{"type": "line"}')
    assert run("audit", "verify", file).status == 1


def test_what_is_left_out_of_the_log_is_said(run):
    run("user", "add", "ann")
    run(*ADD)
    assert run("audit", "--limit", 2).err == ""
    done = run("audit", "--limit", 1)
    assert "robot_added" in done.out
    assert done.err == "older events than the newest 1 are left out: see --limit\n"


def test_older_export_finds_what_was_rewritten(run, admin_database, tmp_path):
    """It also finds a chain that was deleted."""
    run(*ADD)
    head = SigningKey("x" * 32, "x")
    with admin_database.transaction() as tx:
        (_, line) = audit_chains.read_chains(tx, "sim1")
        text = statement("sim1", 1, line.hash, None)
        values = (line.hash, head.public_key, head.sign(NAMESPACE, text))
        tx.change(
            "INSERT INTO audit_heads (chain, position, hash, signer, public_key, signature) "
            "VALUES ('sim1', 1, UNHEX(%s), 'server', %s, %s)",
            values,
        )
    (tmp_path / "older").write_text(run("audit", "export", "--robot", "sim1").out)
    assert run("audit", "verify", "--against", tmp_path / "older").status == 0
    with admin_database.transaction() as tx:
        for table in ("audit_events", "audit_chains", "audit_heads"):
            tx.change(f"DELETE FROM {table}")
    assert "the audit log: it has no line" in run("audit", "verify").err
    assert "sim1" in run("audit", "verify", "--against", tmp_path / "older").err
    assert "of robot sim9: it has no line" in run("audit", "export", "--robot", "sim9").err
    # An export that failed, as on a full disk.
    (tmp_path / "empty").write_text("")
    assert "empty: it has no line" in run("audit", "verify", tmp_path / "empty").err
    done = run("audit", "verify", tmp_path / "older", "--against", tmp_path / "empty")
    assert "it has no signed head" in done.err


def test_restored_backup_has_a_status_of_its_own(run, admin_database):
    """A change has the status of a change, also then."""
    run(*ADD)
    with admin_database.transaction() as tx:
        tx.change("CALL record_restore()")
    done = run("audit", "verify")
    assert (done.status, done.err) == (3, "")
    assert "sim1: 2 lines fit; " in done.out
    assert "A BACKUP WAS PUT BACK" in done.out
    with admin_database.transaction() as tx:
        tx.change("UPDATE audit_events SET actor = 'ben' WHERE kind = 'robot_added'")
    assert run("audit", "verify").status == 1


def test_servers_key_is_that_of_the_session_key(run, monkeypatch):
    monkeypatch.setenv("SESSION_KEY", "x" * 32)
    expected = server_key("x" * 32).public_key
    assert run("audit", "key").out.strip() == fingerprint(expected)
