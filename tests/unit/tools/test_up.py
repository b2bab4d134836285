"""tools/up, with programs in the place of Docker and the other tools that note how they are called."""

import pytest
from commands import copy_tools, path_with, run_command, write_programs

# Answers from files, and notes all that it is asked.
COMPOSE = """#!/bin/sh
echo "${COMPOSE_PROFILES:+[$COMPOSE_PROFILES] }$*" >> calls
case "$*" in
  --env*) [ ! -e env ] || sed -n "s/^$2=//p" env ;;
  config) echo 'name: robots' ;;
  'config --images') printf 'reg.test:5000/robotether/%s:1\\n' web prometheus web ;;
  'config --services') printf 'secrets\\nweb\\n'; cat database services ;;
  run*) exit "$(cat "${*##* }_status")" ;;
  *openssl*) echo 'sha256 Fingerprint=AA:BB' ;;
esac
"""


@pytest.fixture
def checkout(tmp_path):
    """A checkout with tools/up and nothing that needs Docker, before the first start."""
    copy_tools(tmp_path, "up")
    tools = tmp_path / "tools"
    noted = ("ensure_docker", "ensure_base_image", "build")
    write_programs(tools, {name: f"echo {name} $* >> calls" for name in noted})
    write_programs(tools, {"compose": COMPOSE})
    write_programs(tmp_path / "programs", {"docker": "cat volumes"})
    (tmp_path / "compose" / "secrets").mkdir(parents=True)
    (tmp_path / "database").write_text("mysql\n")
    (tmp_path / "services").write_text("")
    for service in ("settings", "certificate", "secrets"):
        (tmp_path / f"{service}_status").write_text("0")
    (tmp_path / "volumes").write_text("")
    return tmp_path


def up(checkout, *arguments, status=0):
    """Run tools/up there."""
    environment = path_with(checkout / "programs")
    done = run_command("tools/up", *arguments, cwd=checkout, env=environment)
    assert done.returncode == status, done.stderr
    return done


def calls(checkout):
    return (checkout / "calls").read_text()


def test_first_start_makes_a_password_that_only_its_owner_reads(checkout):
    """It is told now and at each later start, also in a folder of one's own that is not there yet."""
    (checkout / "env").write_text("SECRETS_DIR=../vault\n")
    first = up(checkout)
    made = checkout / "vault" / "admin_password"
    assert len(made.read_text()) > 40
    assert (made.stat().st_mode & 0o777, made.parent.stat().st_mode & 0o777) == (0o600, 0o700)
    (checkout / "volumes").write_text("robots_mysql\n")
    assert all(
        f"  password  {made.read_text()} " in said for said in (first.stdout, up(checkout).stdout)
    )


def test_no_password_is_told_that_admin_does_not_have(checkout):
    """A stack with data has an admin, whose password a new file would not be."""
    (checkout / "volumes").write_text("robots_mysql\n")
    assert "the one that admin had before" in up(checkout).stdout
    (checkout / "volumes").unlink()
    assert "nobody knows whether this machine has data" in up(checkout, status=1).stderr
    assert not (checkout / "compose" / "secrets" / "admin_password").exists()


def test_images_of_all_that_runs_are_built(checkout):
    """Prometheus runs with a profile of its own, for example."""
    up(checkout)
    assert "\nbuild prometheus web\n" in calls(checkout)


@pytest.mark.parametrize("service", ["settings", "certificate", "secrets"])
def test_what_cannot_be_used_stops_the_start(checkout, service):
    """The service that tries it runs alone, before anything is replaced."""
    (checkout / f"{service}_status").write_text("1")
    done = up(checkout, status=1)
    assert "nothing was started or changed" in done.stderr
    assert "up --detach" not in calls(checkout)


@pytest.mark.parametrize(
    ("service", "setting"),
    [
        ("acme", "DOMAIN=robots.example.org"),
        ("direct", "DIRECT_SOURCES=192.0.2.0/24"),
        ("alertmanager", "ALERT_EMAIL_TO=ann@lab.example"),
    ],
)
def test_setting_and_its_service_go_together(checkout, service, setting):
    """One alone is told before anything is started; a service of before is taken away with its setting."""
    (checkout / "env").write_text(f"{setting}\n")
    done = up(checkout, status=1)
    assert f"cannot start: {setting.partition('=')[0]} is set and the service {service} is off" in (
        done.stderr
    )
    assert "up --detach" not in calls(checkout)
    (checkout / "env").unlink()
    up(checkout)
    # A person may run Prometheus alone.
    takes_away = f"--profile {service} rm --stop --force {service}" in calls(checkout)
    assert takes_away is (service != "alertmanager")
