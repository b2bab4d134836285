"""tools/up, with programs in the place of Docker and the other tools that note how they are called."""

from __future__ import annotations

import os
import shutil
import subprocess
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from dated_certificate import make_certificate

ROOT = Path(__file__).resolve().parents[3]
# Answers the lists from a file, and what `tools/compose` itself knows; notes all that it is asked.
COMPOSE = """#!/bin/sh
echo "$*" >> calls
case "$*" in
  --secrets-dir) echo secrets ;;
  --env*) [ ! -e env ] || sed -n "s/^$2=//p" env ;;
  *'user list') cat users ;;
  *'robot list') cat robots ;;
  *openssl*) echo 'sha256 Fingerprint=AA:BB' ;;
esac
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A checkout with tools/up and nothing that needs Docker; it has an admin and no robot."""
    tools = tmp_path / "tools"
    tools.mkdir()
    for name in ("up", "common.sh"):
        shutil.copy(ROOT / "tools" / name, tools)
    for name in ("ensure_docker", "ensure_base_image", "build"):
        (tools / name).write_text(f"#!/bin/sh\necho {name} >> calls\n")
    (tools / "compose").write_text(COMPOSE)
    for path in tools.iterdir():
        path.chmod(0o755)
    (tmp_path / "compose").mkdir()
    (tmp_path / "compose" / ".env").write_text("")
    (tmp_path / "users").write_text("NAME   ROLE   STATE\nadmin  admin  enabled\n")
    (tmp_path / "robots").write_text("NAME  STATE\n")
    return tmp_path


def up(checkout: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run tools/up there."""
    environment = {"PATH": os.environ["PATH"]}
    command = ["tools/up", *arguments]
    return subprocess.run(
        command, cwd=checkout, env=environment, check=False, capture_output=True, text=True
    )


def calls(checkout: Path) -> str:
    return (checkout / "calls").read_text()


@pytest.mark.parametrize(
    ("name", "is_made"), [("admin", False), ("admin-2", True), ("admin.old", True), ("root", True)]
)
def test_only_the_name_itself_is_the_admin(checkout: Path, name: str, is_made: bool) -> None:
    """A user whose name only begins so, or has the role, is another one."""
    (checkout / "users").write_text(f"NAME  ROLE   STATE\n{name}  admin  enabled\n")
    assert up(checkout).returncode == 0
    assert ("user add admin --role admin" in calls(checkout)) is is_made


def test_demo_makes_the_robots_that_are_missing(checkout: Path) -> None:
    """A robot whose name only begins so is another one; the first keys of simulators need no question."""
    (checkout / "robots").write_text("NAME    STATE\nsim1-b  active\nsim2    active\n")
    done = up(checkout, "--demo")
    assert done.returncode == 0, done.stderr
    said = calls(checkout)
    for name, is_added in (("sim1", True), ("sim2", False), ("sim3", True)):
        assert (f"robot add {name} --mac" in said) is is_added
        assert f"robot approve {name} --yes --wait-for-key 60" in said


@pytest.mark.parametrize("content", [None, (), ("ticket_key",)])
def test_folder_of_our_secrets_is_closed(checkout: Path, content: tuple[str, ...] | None) -> None:
    """Whether it was made now, was empty, or has secrets of an earlier start, which stay."""
    secrets = checkout / "secrets"
    if content is not None:
        secrets.mkdir()
        secrets.chmod(0o755)
        for name in content:
            (secrets / name).write_text("kept")
    (checkout / "users").write_text("")
    assert up(checkout).returncode == 0
    assert secrets.stat().st_mode & 0o777 == 0o700
    assert ((secrets / "ticket_key").read_text() == "kept") is bool(content)
    assert len((secrets / "admin_password").read_text()) > 40


def test_no_password_is_told_that_admin_does_not_have(checkout: Path) -> None:
    """One that was made with the admin is told each time; an admin from before this folder has another one."""
    (checkout / "users").write_text("")
    made = up(checkout).stdout
    (checkout / "users").write_text("NAME   ROLE   STATE\nadmin  admin  enabled\n")
    password = (checkout / "secrets" / "admin_password").read_text().strip()
    assert len(password) > 40
    assert all(f"  password  {password} " in said for said in (made, up(checkout).stdout))
    shutil.rmtree(checkout / "secrets")
    assert "the one that admin had before" in up(checkout).stdout
    assert not (checkout / "secrets" / "admin_password").exists()


def test_folder_that_others_use_is_left_alone(checkout: Path) -> None:
    """One sentence says what to do, and nothing is written or closed."""
    secrets = checkout / "secrets"
    secrets.mkdir()
    secrets.chmod(0o750)
    (secrets / "letters").write_text("")
    done = up(checkout)
    assert done.returncode == 1
    assert "cannot keep secrets in secrets: other users may read it" in done.stderr
    assert secrets.stat().st_mode & 0o777 == 0o750
    assert [path.name for path in secrets.iterdir()] == ["letters"]


def test_closed_folder_may_hold_more(checkout: Path) -> None:
    """Somebody's own vault is as good as a folder of ours."""
    secrets = checkout / "secrets"
    secrets.mkdir(mode=0o700)
    (secrets / "letters").write_text("")
    assert up(checkout).returncode == 0
    assert (secrets / "ticket_key").exists()


def test_images_from_elsewhere_are_taken_as_they_are(checkout: Path) -> None:
    """With --no-build nothing is built, and no base image is wanted."""
    done = up(checkout, "--no-build")
    assert done.returncode == 0, done.stderr
    assert "build" not in calls(checkout)
    assert "ensure_base_image" not in calls(checkout)
    assert up(checkout).returncode == 0
    assert "build" in calls(checkout)


def make_pair(folder: Path, name: str, *, days: int = 2) -> tuple[Path, Path]:
    """A self-signed certificate that began nine days ago and ends in so many, and its key."""
    now = datetime.now(UTC)
    end = now + timedelta(days=days)
    both = make_certificate(folder, now - timedelta(days=9), end)
    cert, key = folder / f"{name}.crt", folder / f"{name}.key"
    begin_of_key = "-----BEGIN PRIVATE KEY-----"
    certificate, _, private = both.read_text().partition(begin_of_key)
    cert.write_text(certificate)
    key.write_text(begin_of_key + private)
    return cert, key


def test_own_certificate_is_handed_to_nginx_and_taken_back(checkout: Path) -> None:
    """It is copied when both settings name a pair, and removed when they are empty again."""
    cert, key = make_pair(checkout, "robots.example.org")
    (checkout / "env").write_text(f"TLS_CERT_FILE={cert}\nTLS_KEY_FILE={key}\n")
    assert up(checkout).returncode == 0
    folder = checkout / "secrets" / "tls"
    assert (folder / "cert.pem").read_bytes() == cert.read_bytes()
    assert (folder / "key.pem").read_bytes() == key.read_bytes()
    (checkout / "env").write_text("TLS_CERT_FILE=\n")
    assert up(checkout).returncode == 0
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize(
    ("cert", "key", "why"),
    [
        ("one.crt", "", "set both"),
        ("", "one.key", "set both"),
        ("none.crt", "one.key", "none.crt is missing"),
        ("one.crt", "two.key", "is not the key of"),
        ("one.key", "one.key", "is no certificate"),
        ("ended.crt", "ended.key", "has ended"),
    ],
)
def test_own_certificate_that_cannot_serve_stops_the_start(
    checkout: Path, cert: str, key: str, why: str
) -> None:
    """With a sentence, before anything is started."""
    make_pair(checkout, "one")
    make_pair(checkout, "two")
    make_pair(checkout, "ended", days=-1)
    (checkout / "env").write_text(f"TLS_CERT_FILE={cert}\nTLS_KEY_FILE={key}\n")
    done = up(checkout)
    assert done.returncode == 1
    assert "cannot use your own certificate" in done.stderr
    assert why in done.stderr
    assert "up --detach" not in calls(checkout)


@pytest.mark.parametrize(("domain", "starts"), [("robots.example.org", True), ("", False)])
def test_acme_runs_when_there_is_a_domain(checkout: Path, domain: str, starts: bool) -> None:
    """Nothing waits for it; without a domain one of before is taken away."""
    (checkout / "env").write_text(f"DOMAIN={domain}\n")
    assert up(checkout).returncode == 0
    assert ("up --detach acme" in calls(checkout)) is starts
    assert ("--profile acme rm --stop --force acme" in calls(checkout)) is not starts


@pytest.mark.parametrize(("sources", "opens"), [("192.0.2.0/24", True), ("", False)])
def test_open_ports_are_opened_and_closed_again(checkout: Path, sources: str, opens: bool) -> None:
    """The door is started with the stack when somebody is let in, and taken away when nobody is."""
    (checkout / "env").write_text(f"DIRECT_SOURCES={sources}\n")
    assert up(checkout).returncode == 0
    assert ("up --detach --wait nginx web relay sshd mysql direct" in calls(checkout)) is opens
    assert ("rm --stop --force direct" in calls(checkout)) is not opens
