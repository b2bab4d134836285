"""compose/compose.override.yaml.example, as docker compose understands it beside compose.yaml."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

COMPOSE = Path(__file__).resolve().parents[2] / "compose"


def config(folder):
    """What is in force in a folder where a site has its files."""
    done = subprocess.run(
        ["docker", "compose", "config", "--format", "json"],
        cwd=folder, env={"PATH": os.environ["PATH"], "HOME": str(folder)},
        capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def published(service):
    return {(port["host_ip"], port["published"], port["target"]) for port in service["ports"]}


def test_example_changes_what_it_says(tmp_path):
    shutil.copy(COMPOSE / "compose.yaml", tmp_path)
    before = config(tmp_path)
    shutil.copy(COMPOSE / "compose.override.yaml.example", tmp_path / "compose.override.yaml")
    after = config(tmp_path)
    assert set(after["services"]) == set(before["services"])
    assert set(after["networks"]) == set(before["networks"])
    nginx = [stack["services"]["nginx"] for stack in (before, after)]
    assert published(nginx[1]) - published(nginx[0]) == {("127.0.0.1", "8443", 8443)}
    assert published(nginx[0]) < published(nginx[1])
    assert nginx[1]["logging"] == {"driver": "journald", "options": {"tag": "{{.Name}}"}}
    assert int(after["services"]["mysql"]["mem_limit"]) == 2**30
    assert after["services"]["web"]["cpus"] == 2
    assert after["networks"]["data"]["internal"]
    assert after["networks"]["data"]["ipam"]["config"] == [{"subnet": "10.213.3.0/24"}]
    assert after["volumes"]["mysql"]["driver_opts"]["device"] == "/srv/robotether/mysql"


@pytest.mark.parametrize(
    ("setting", "services"),
    [
        ("TLS_CERT_FILE=./own.pem\nTLS_KEY_FILE=./own.pem", {"certificate", "nginx"}),
        ("MAX_PENDING=49", {"settings", "web", "relay"}),
    ],
    ids=["certificate", "max-pending"],
)
def test_setting_makes_only_these_services_anew(tmp_path, setting, services):
    """Compose makes anew all that depends on a service whose settings changed; robots' sessions are elsewhere."""
    shutil.copy(COMPOSE / "compose.yaml", tmp_path)
    (tmp_path / ".env").write_text("COMPOSE_PROFILES=demo,demo-more\n")
    before = config(tmp_path)["services"]
    with (tmp_path / ".env").open("a") as file:
        file.write(setting)
    after = config(tmp_path)["services"]
    anew = {name for name in after if after[name] != before[name]}
    while more := {
        name for name in after if anew & set(after[name].get("depends_on", ())) and name not in anew
    }:
        anew |= more
    assert anew == services
