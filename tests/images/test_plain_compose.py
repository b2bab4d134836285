"""`docker compose up` in a fresh copy of the repository, with Docker alone: no tool, no file made before."""

import json
import os
import re
import shutil
import ssl
import urllib.error
import uuid
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from commands import output_of_command, run_command
from dated_certificate import make_certificate
from documented import tracked
from local_network import free_port
from logins import Login
from openssh_server import wait_until

ROOT = Path(__file__).resolve().parents[2]
PASSWORD = re.compile(r"password  (\S+)")


class PlainCompose:
    """A copy of this checkout, with a name and ports of its own, and images of a tag that nothing else has."""

    def __init__(self, folder, ports_of=None):
        """Take the place of the stack `ports_of`, if there is one, with its images and address."""
        self._folder = folder / "robotether"
        self._name = f"robotether-test-{uuid.uuid4().hex[:8]}"
        self._programs = folder / "programs"
        self.settings = {
            "COMPOSE_PROJECT_NAME": self._name,
            "TAG": self._name,
            "HTTP_PORT": free_port(),
            "HTTPS_PORT": free_port(),
            "SSH_PORT": free_port(),
            "CA_BUNDLE": os.environ.get("SSL_CERT_FILE", ""),
        }
        if ports_of is not None:
            names = ("TAG", "HTTP_PORT", "HTTPS_PORT", "SSH_PORT")
            self.settings |= {name: ports_of.settings[name] for name in names}
        self._copy()

    @property
    def compose_folder(self):
        return self._folder / "compose"

    @property
    def url(self):
        return f"https://localhost:{self.settings['HTTPS_PORT']}/"

    def run(self, *arguments, timeout=600):
        environment = {name: str(value) for name, value in self.settings.items()}
        environment |= {"PATH": str(self._programs), "HOME": os.environ["HOME"]}
        words = ("docker", "compose", *arguments)
        return run_command(*words, cwd=self.compose_folder, env=environment, limit_s=timeout)

    def tool(self, name, *arguments):
        settings = {name: str(value) for name, value in self.settings.items()}
        environ = os.environ | settings
        return output_of_command(self._folder / name, *arguments, env=environ, limit_s=600)

    def compose(self, *arguments):
        done = self.run(*arguments)
        if done.returncode != 0:
            raise AssertionError(
                f"docker compose {' '.join(arguments)} exited {done.returncode}\n{done.stdout[-4000:]}\n"
                f"{done.stderr[-4000:]}\n{self.run('logs', '--tail', '40').stdout[-8000:]}"
            )
        return done.stdout

    def states(self):
        """Service -> `healthy`, `exited 0` or whatever else its container is."""
        listed = self.compose("ps", "--all", "--format", "{{json .}}").splitlines()
        found = {row["Service"]: row for row in map(json.loads, listed)}
        return {
            name: item["Health"] or f"{item['State']} {item['ExitCode']}"
            for name, item in found.items()
        }

    def log(self, service):
        return self.compose("logs", "--no-log-prefix", service)

    def robots(self):
        listed = self.compose("exec", "-T", "web", "robotether", "robot", "list", "--json")
        return {row["name"]: row for row in json.loads(listed)}

    def wait(self, what, condition, *services, seconds=60):
        wait_until(
            condition, lambda: f"{what}\n{self.compose('logs', *services)}", seconds, every_s=0.5
        )

    def accepts_login(self, password):
        """Whether the log-in form takes this password for admin, and then shows who is logged in."""
        try:
            login = Login(self.url.rstrip("/"), "admin", password)
        except urllib.error.HTTPError as refused:
            refused.close()
            return False
        return login.is_in and "admin" in login.page

    def down(self, *, images=True):
        """Remove containers, networks and volumes, and images unless another stack has them."""
        also = ["--rmi", "all"] if images else []
        self.run("--profile", "*", "down", "--volumes", "--timeout", "5", *also)

    def _copy(self):
        """Copy what git has or would take, and make a folder of programs that has docker alone."""
        for path in tracked():
            copy = self._folder / path.relative_to(ROOT)
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, copy)
        self._programs.mkdir()
        docker = shutil.which("docker")
        (self._programs / "docker").symlink_to(docker)


SERVICES = dict.fromkeys(("nginx", "web", "relay", "recorder", "sshd", "mysql"), "healthy")
ONE_SHOTS = dict.fromkeys(("settings", "certificate", "secrets", "migrate"), "exited 0")
# Compose's lines about a service whose image it asks a registry for.
PULL_PROGRESS = re.compile(r"^ [\w-]+ (?:Pulling|Warning|Error)\b.*", re.MULTILINE)
SIMS = ("sim1", "sim2", "sim3", "sim4", "sim5")
KINDS = ["differential", "holonomic", "ackermann", "differential", "differential"]
ADMIN_COMMAND = ("exec", "-T", "web", "robotether")

pytestmark = pytest.mark.release


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """What the first start made; the images too are built by it."""
    plain = PlainCompose(tmp_path_factory.mktemp("plain"))
    try:
        started = plain.run("up", "--detach", "--wait")
        assert started.returncode == 0, started.stderr[-4000:]
        assert PULL_PROGRESS.findall(started.stderr) == []
        yield plain
    finally:
        plain.down()


def test_stack_is_healthy_and_lets_the_first_admin_in(site):
    """Nobody else runs, and the log of web has address, name and password once."""
    assert site.states() == SERVICES | ONE_SHOTS
    log = site.log("web")
    assert f"open      {site.url}\n" in log
    assert "user      admin\n" in log
    [password] = PASSWORD.findall(log)
    assert site.accepts_login(password)
    assert not site.accepts_login(f"{password}x")


def test_nothing_secret_is_printed_again(site):
    [password] = PASSWORD.findall(site.log("web"))
    site.compose("up", "--detach", "--wait")
    assert site.log("web").count(password) == 1
    site.compose("up", "--detach", "--wait", "--force-recreate", "--no-deps", "web")
    assert PASSWORD.findall(site.compose("logs")) == []
    assert site.accepts_login(password)


def test_simulated_robots_join_by_themselves(site):
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


def served(site):
    port = int(site.url.rstrip("/").rpartition(":")[2])
    return ssl.get_server_certificate(("localhost", port))


def test_own_certificate_serves_and_a_wrong_one_changes_nothing(site):
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


def test_open_ports_need_a_list_of_sources(site):
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


def backup_ages(site):
    """What the metrics say of the last backup and its copy."""
    script = "from urllib.request import urlopen; print(urlopen('http://127.0.0.1:9100/metrics').read().decode())"
    metrics = site.compose("exec", "-T", "relay", "python3", "-c", script)
    return re.findall(r"^robotether_relay_backup_\w+ (\S+)$", metrics, re.MULTILINE)


def test_backup_alone_makes_the_server_on_another_machine(site, tmp_path):
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
