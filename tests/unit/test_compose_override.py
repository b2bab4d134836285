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
