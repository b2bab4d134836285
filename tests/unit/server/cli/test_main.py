"""The command itself: settings, migrate, web, and the border of errors."""

import os
import subprocess
import sys

import pytest
from robotether_server import passwords
from robotether_server.db import users


def test_wrong_setting_stops_every_start(run, monkeypatch):
    monkeypatch.setenv("DB_PORT", "many")
    for command in ("web", "migrate", "show-settings"):
        done = run(command)
        assert (done.status, done.err.count("\n")) == (1, 1)
        assert "cannot use DB_PORT='many'" in done.err


def test_migrate_makes_the_first_admin_with_a_password_alone(
    *, run, mariadb, database, monkeypatch, sql_dir
):
    settings = mariadb.settings("migrate")
    monkeypatch.setenv("DB_USER", settings.user)
    monkeypatch.setenv("DB_PASSWORD", settings.password)
    monkeypatch.setenv("MIGRATIONS_DIR", str(sql_dir))
    monkeypatch.setenv("PORT_RANGE_LAST", "20199")
    run("migrate")
    with database.transaction() as tx:
        assert users.list_all(tx) == []
    monkeypatch.setenv("ADMIN_PASSWORD", "a-password-of-ones-own")
    assert "made the first user: admin\n" in run("migrate").out
    monkeypatch.setenv("ADMIN_PASSWORD", "another-password")
    done = run("migrate")
    assert (done.status, "admin" in done.out) == (0, False)
    with database.transaction() as tx:
        assert passwords.matches("a-password-of-ones-own", users.get(tx, "admin").password_hash)


@pytest.fixture
def started(monkeypatch):
    monkeypatch.setenv("TICKET_KEY", "t" * 32)
    monkeypatch.setenv("WEB_SECRET_KEY", "w" * 32)
    found = []
    monkeypatch.setattr(os, "execv", lambda _, arguments: found.append(arguments))
    return found


def test_web_prints_the_first_admin_once(run, started, database, monkeypatch):
    monkeypatch.setenv("PUBLIC_HOST", "robots.example")
    monkeypatch.setenv("PUBLIC_PORT", "8443")
    said = run("web").out
    assert "open      https://robots.example:8443/\n" in said
    assert "user      admin\n" in said
    with database.transaction() as tx:
        assert passwords.matches(said.split()[-1], users.get(tx, "admin").password_hash)
    assert run("web") == (0, "", "")
    assert [words[:3] for words in started] == [[sys.executable, "-m", "gunicorn"]] * 2
    assert {"--workers=1", "--worker-class=gthread", "--threads=8"} <= set(started[0])
    # nginx lets lines through that are longer than gunicorn's own limits.
    assert {"--limit-request-line=0", "--limit-request-field_size=16384"} <= set(started[0])
    assert started[0][-1] == "robotether_server.web.app:start_app()"


def test_web_starts_while_the_database_is_away(run, started, monkeypatch):
    """After a reboot nobody says who starts first; then there is an admin already."""
    monkeypatch.setenv("DB_PORT", "1")
    done = run("web")
    assert done.status == 0
    assert "cannot check for a first admin" in done.err
    assert len(started) == 1


def test_the_command_needs_no_server():
    """`pip install ./server` is enough for it: what serves pages, tunnels and recordings stays in the extras."""
    extras = (
        "aiohttp",
        "av",
        "flask",
        "gunicorn",
        "itsdangerous",
        "mcap",
        "prometheus_client",
        "uvloop",
    )
    lines = ["import sys", *(f"sys.modules[{name!r}] = None" for name in extras)]
    lines += ["import robotether_server.cli.main, robotether_server.cli.fleet"]
    environ = {"PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "-c", "\n".join(lines)], env=environ, check=True)
