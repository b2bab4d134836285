"""`docker compose up` in a fresh copy of the repository, with Docker alone: no tool, no file made before."""

from __future__ import annotations

import json
import re
import ssl
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from dated_certificate import make_certificate
from local_network import free_port
from plain_compose import PASSWORD, PlainCompose

SERVICES = dict.fromkeys(("nginx", "web", "relay", "recorder", "sshd", "mysql"), "healthy")
ONE_SHOTS = dict.fromkeys(("settings", "certificate", "secrets", "migrate"), "exited 0")
# Compose's lines about a service whose image it asks a registry for.
PULL_PROGRESS = re.compile(r"^ [\w-]+ (?:Pulling|Warning|Error)\b.*", re.MULTILINE)
SIMS = ("sim1", "sim2", "sim3", "sim4", "sim5")
KINDS = ["differential", "holonomic", "ackermann", "differential", "differential"]
ADMIN_COMMAND = ("exec", "-T", "web", "robotether")

pytestmark = pytest.mark.release


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PlainCompose]:
    """What the first start made; the images too are built by it."""
    plain = PlainCompose(tmp_path_factory.mktemp("plain"))
    try:
        started = plain.run("up", "--detach", "--wait")
        assert started.returncode == 0, started.stderr[-4000:]
        assert PULL_PROGRESS.findall(started.stderr) == []
        yield plain
    finally:
        plain.down()


def test_stack_is_healthy_and_lets_the_first_admin_in(site: PlainCompose) -> None:
    """Nobody else runs, and the log of web has address, name and password once."""
    assert site.states() == SERVICES | ONE_SHOTS
    log = site.log("web")
    assert f"open      {site.url}\n" in log
    assert "user      admin\n" in log
    [password] = PASSWORD.findall(log)
    assert site.accepts_login(password)
    assert not site.accepts_login(f"{password}x")


def test_nothing_secret_is_printed_again(site: PlainCompose) -> None:
    [password] = PASSWORD.findall(site.log("web"))
    site.compose("up", "--detach", "--wait")
    assert site.log("web").count(password) == 1
    site.compose("up", "--detach", "--wait", "--force-recreate", "--no-deps", "web")
    assert PASSWORD.findall(site.compose("logs")) == []
    assert site.accepts_login(password)


def test_simulated_robots_join_by_themselves(site: PlainCompose) -> None:
    site.settings["COMPOSE_PROFILES"] = "demo,demo-more"
    site.compose("up", "--detach", "--wait")
    site.wait("online", lambda: all(robot["online"] for robot in site.robots().values()), *SIMS)
    before = site.robots()
    assert {name: item["state"] for name, item in before.items()} == dict.fromkeys(SIMS, "active")
    kinds = [
        json.loads(site.compose("exec", "-T", "web", "robotether", "robot", "settings", name))
        for name in SIMS
    ]
    assert [service["page"]["kind"] for service in kinds] == KINDS
    tokens = site.compose("exec", "-T", "web", "robotether", "join-token", "list").splitlines()
    assert [line.split()[:4] for line in tokens[1:]] == [["demo", "5", "of", "5"]]
    assert "rj_" not in site.compose("logs")
    site.compose("up", "--detach", "--wait", "--force-recreate", "--no-deps", *SIMS)
    site.wait("online", lambda: all(robot["online"] for robot in site.robots().values()), *SIMS)
    after = site.robots()
    assert {name: item["fingerprint"] for name, item in after.items()} == {
        name: item["fingerprint"] for name, item in before.items()
    }
    assert (
        site.compose("exec", "-T", "web", "robotether", "join-token", "list").splitlines() == tokens
    )


def served(site: PlainCompose) -> str:
    port = int(site.url.rstrip("/").rpartition(":")[2])
    return ssl.get_server_certificate(("localhost", port))


def test_own_certificate_serves_and_a_wrong_one_changes_nothing(site: PlainCompose) -> None:
    """The files are beside compose.yaml. `up` says that one is wrong, and all other services run on, new ones too."""
    now = datetime.now(UTC)
    both = make_certificate(site.compose_folder, now - timedelta(days=1), now + timedelta(days=9))
    # Compose makes a service anew that was last made with --no-deps.
    site.compose("up", "--detach", "--wait")
    before = site.compose("ps", "--quiet", "relay", "sshd", "sim1")
    site.settings |= {"TLS_CERT_FILE": both.name, "TLS_KEY_FILE": both.name}
    site.compose("up", "--detach", "--wait")
    # No robot's session has ended.
    assert site.compose("ps", "--quiet", "relay", "sshd", "sim1") == before
    site.wait("served", lambda: served(site).strip() in both.read_text(), "nginx")
    good = both.read_text()
    both.write_text(good[: len(good) // 2])
    site.settings["LOG_LEVEL"] = "debug"
    said = site.run("up", "--detach")
    assert said.returncode == 0
    running = SERVICES | ONE_SHOTS | {"certificate": "exited 1"}
    site.wait("all others", lambda: running.items() <= site.states().items(), *SERVICES)
    assert '"certificate" didn\'t complete successfully' in said.stderr
    assert "cannot use your own certificate: " in site.log("certificate")
    assert served(site).strip() in good
    site.settings |= {"TLS_CERT_FILE": "", "TLS_KEY_FILE": "", "LOG_LEVEL": "info"}
    site.compose("up", "--detach", "--wait")
    site.wait("taken back", lambda: served(site).strip() not in good, "nginx")


def test_open_ports_need_a_list_of_sources(site: PlainCompose) -> None:
    """The profile alone opens nothing; relay and robots hear of it when there is a list."""
    first = free_port()
    site.settings |= {
        "COMPOSE_PROFILES": "direct",
        "DIRECT_PORT_FIRST": first,
        "DIRECT_PORT_LAST": first,
    }
    site.compose("up", "--detach")
    site.wait("the refusal", lambda: "DIRECT_SOURCES is ''" in site.log("direct"), "direct")
    assert "are open to" not in site.log("direct")
    assert "DIRECT_PORTS=no\n" in site.compose("exec", "relay", "robotether", "show-settings")
    site.settings["DIRECT_SOURCES"] = "10.0.0"
    assert site.run("up", "--detach").returncode != 0
    assert "cannot use DIRECT_SOURCES='10.0.0': allowed is networks such as" in site.log("settings")
    site.settings["DIRECT_SOURCES"] = "192.0.2.0/24"
    site.compose("up", "--detach", "--wait")
    assert f"ports {first} to {first} are open to 192.0.2.0/24" in site.log("direct")
    assert "DIRECT_PORTS=yes\n" in site.compose("exec", "relay", "robotether", "show-settings")


def backup_ages(site: PlainCompose) -> list[str]:
    """What the metrics say of the last backup and its copy."""
    script = "from urllib.request import urlopen; print(urlopen('http://127.0.0.1:9100/metrics').read().decode())"
    metrics = site.compose("exec", "-T", "relay", "python3", "-c", script)
    return re.findall(r"^robotether_relay_backup_\w+ (\S+)$", metrics, re.MULTILINE)


def test_backup_alone_makes_the_server_on_another_machine(
    site: PlainCompose, tmp_path: Path
) -> None:
    """Robots that run on find the same server there, and an admin logs in; it has made no backup itself."""
    site.settings |= {
        "COMPOSE_PROFILES": "demo",
        "BACKUP_COPY_COMMAND": f"cp --target-directory {tmp_path}",
    }
    (site.compose_folder / ".env").write_text("MAX_PENDING=49\n")
    site.compose("up", "--detach", "--wait")
    password = site.compose(*ADMIN_COMMAND, "user", "password", "admin").split()[-1]
    before = site.robots()
    assert backup_ages(site) == ["+Inf", "+Inf"]
    site.tool("tools/backup", str(tmp_path / "here"))
    assert all(0 <= float(age) < 3600 for age in backup_ages(site))
    [backup] = tmp_path.glob("*.tar")
    site.compose("stop", *SERVICES)
    other = PlainCompose(tmp_path / "other", ports_of=site)
    try:
        other.tool("tools/restore", str(backup))
        assert (other.compose_folder / ".env").read_text() == "MAX_PENDING=49\n"
        other.compose("up", "--detach", "--wait")
        other.wait("online", lambda: other.robots()["sim1"]["online"], "sshd", seconds=180)
        after = other.robots()
        assert {name: item["fingerprint"] for name, item in after.items()} == {
            name: item["fingerprint"] for name, item in before.items()
        }
        assert other.accepts_login(password)
        assert backup_ages(other) == ["+Inf", "+Inf"]
        other.compose(*ADMIN_COMMAND, "robot", "remove", "sim1", "--yes")
        other.tool("tools/restore", "--database", str(backup))
        other.compose("up", "--detach", "--wait")
        assert other.robots().keys() == before.keys()
        # One line of each restore: the second put the first one's away, too.
        lines = other.compose(
            *ADMIN_COMMAND, "audit", "--kind", "records_restored", "--robot", "sim1"
        )
        assert len(lines.splitlines()) == 2
    finally:
        other.down(images=False)
        (site.compose_folder / ".env").unlink()
        site.compose("up", "--detach", "--wait")
