"""deploy/swarm, as Docker reads it, beside compose/compose.yaml: Swarm leaves out in silence what it does not know."""

import os
import re
import subprocess
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[3]
SWARM = ROOT / "deploy" / "swarm"
SERVICES = {
    "database.yaml": ("mysql", "migrate"),
    "cell.yaml": ("nginx", "web", "relay", "recorder", "sshd"),
}
BOTH = [(file, name) for file, names in SERVICES.items() for name in names]
# Everything that a service has there; Swarm heeds it all.
HEEDED = {
    *("cap_add", "cap_drop", "command", "deploy", "environment", "healthcheck", "image", "init"),
    *("logging", "networks", "ports", "read_only", "secrets", "stop_grace_period", "sysctls"),
    "volumes",
}
# Of one cell among others, and always with TLS to the database.
SET_OTHERWISE = {
    *("CELL", "DB_CA_FILE", "PEER_ADDRESS", "PUBLIC_HOST", "PUBLIC_PORT", "SSH_PORTS"),
    # A name of its own.
    "RELAY_HOST",
    # Swarm's files have no service `direct`.
    "DIRECT_PORTS",
}
WATCHDOG = "/usr/lib/robotether/watchdog"
OF_THE_IMAGE = ["CMD", "/usr/lib/robotether/healthy"]
# What it hands out, with each call in one line.
MAKE_SECRETS = (
    (ROOT / "images" / "server" / "make-secrets").read_text(encoding="utf-8").replace("\\\n", "")
)


def services_of(path):
    return yaml.safe_load((ROOT / path).read_text())["services"]


IN_COMPOSE = services_of("compose/compose.yaml")
IN_SWARM = {file: services_of(f"deploy/swarm/{file}") for file in SERVICES}


def config(*files, **settings):
    """What Docker's command makes of the files."""
    named = [word for file in files for word in ("--compose-file", str(SWARM / file))]
    return subprocess.run(
        ["docker", "stack", "config", *named],
        env={"PATH": os.environ["PATH"], **settings},
        capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip


@pytest.mark.parametrize(
    "files", [("database.yaml",), ("cell.yaml",), ("cell.yaml", "certificate.yaml")]
)
def test_docker_reads_the_files(files):
    done = config(*files, CELL="a", PUBLIC_HOST="a.example", SSH_PORT="", TAG="")
    assert done.returncode == 0, done.stderr
    # Docker leaves as it is what it cannot replace, such as a default inside a default.
    assert "${" not in done.stdout


def in_memory(service):
    """Folders in memory, however they are written."""
    short = {entry.split(":")[0] for entry in service.get("tmpfs", [])}
    mounts = [volume for volume in service.get("volumes", []) if isinstance(volume, dict)]
    return short | {mount["target"] for mount in mounts if mount["type"] == "tmpfs"}


def kept(service):
    """Volumes, except those that Swarm has otherwise, or not: secrets, what acme and tools/backup get, disk records."""
    volumes = service.get("volumes", [])
    names = {volume for volume in volumes if isinstance(volume, str)}
    mounts = [v for v in volumes if isinstance(v, dict) and v["type"] == "volume"]
    names |= {
        f"{each['source']}:{each['target']}" for each in mounts if each["source"] != "secrets"
    }
    return {name for name in names if not name.startswith(("acme_", "backup_", "disk_"))}


def published(service):
    """(what it is at the machine, what it is in the container) of each port."""
    found = set()
    for port in service.get("ports", []):
        if isinstance(port, dict):
            assert port["mode"] == "host"
            found.add((port["published"], str(port["target"])))
        else:
            found.add(re.fullmatch(r"\$\{.*?\}:(\$\{.*?\}):(\d+)", port).groups())
    return found


@pytest.mark.parametrize(("file", "name"), BOTH)
def test_service_is_what_it_is_in_compose(file, name):
    """Swarm leaves out what it does not heed, and starts the service without; what is no volume is read-only."""
    ours, theirs = IN_SWARM[file][name], IN_COMPOSE[name]
    assert set(ours) <= HEEDED
    same = ("image", "cap_add", "cap_drop", "read_only", "init", "logging", "sysctls")
    for key in (*same, "stop_grace_period", *(["command"] if "command" in theirs else [])):
        assert ours.get(key) == theirs.get(key), key
    limits = ours["deploy"]["resources"]["limits"]
    assert limits == {"memory": theirs["mem_limit"], "pids": theirs["pids_limit"]}
    if "healthcheck" in theirs:
        # Swarm replaces what is unhealthy by itself.
        command = [word for word in theirs["healthcheck"]["test"] if word != WATCHDOG]
        asked = {"test": OF_THE_IMAGE, **ours["healthcheck"]}
        assert asked == {**theirs["healthcheck"], "test": command}
    assert (in_memory(ours), kept(ours)) == (in_memory(theirs), kept(theirs))
    peers = {("${PEER_PORT:-8444}", "8444")} if name == "nginx" else set()
    assert published(ours) == published(theirs) | peers


@pytest.mark.parametrize(("file", "name"), BOTH)
def test_settings_are_those_of_compose(file, name):
    ours = dict(IN_SWARM[file][name].get("environment", {}))
    theirs = dict(IN_COMPOSE[name].get("environment", {}))
    # A few that only one of these programs reads are given to both.
    known = set().union(
        *(IN_COMPOSE[item].get("environment", {}) for item in ("web", "relay", name))
    )
    assert set(theirs) - SET_OTHERWISE <= set(ours) <= known | SET_OTHERWISE
    for variable in set(ours) & set(theirs) - SET_OTHERWISE:
        assert ours[variable] == theirs[variable], variable


def handed_out(service):
    """Secret -> (user, group), as make-secrets gives them to a service of compose."""
    accounts = {
        name: (user, group)
        for name, user, group in re.findall(r"\b([A-Z]+)=(\d+):(\d+)\b", MAKE_SECRETS)
    }
    found = {}
    calls = re.findall(rf'\b(?:hand_out|put) {service} "\$(\w+)" ([^;\n"]+)', MAKE_SECRETS)
    for account, names in calls:
        for name in names.split():
            found[name] = accounts[account]
    return found


@pytest.mark.parametrize(("file", "name"), BOTH)
def test_services_have_the_secrets_of_compose(file, name):
    secrets = IN_SWARM[file][name]["secrets"]
    ours = {item["source"]: (item["uid"], item["gid"]) for item in secrets}
    optional = {"cert.pem", "key.pem"}
    theirs = {secret: owner for secret, owner in handed_out(name).items() if secret not in optional}
    assert ours == theirs
    assert {item["mode"] for item in secrets} == {0o440}
    declared = yaml.safe_load((SWARM / file).read_text())["secrets"]
    assert all(declared[secret]["name"] == f"robotether_{secret}" for secret in ours)


def test_no_relay_finds_the_sshd_of_another_cell():
    """On a network that cells share, a name stands for the services of all of them."""
    networks = {name: set(item["networks"]) for name, item in IN_SWARM["cell.yaml"].items()}
    relay, sshd = (networks[name] - {"edge", "tunnel"} for name in ("relay", "sshd"))
    assert (bool(relay), bool(sshd), relay & sshd) == (True, True, set())
    # The recorder shares one with all relays, and asks for its own by a name that others do not have.
    own = IN_SWARM["cell.yaml"]["relay"]["networks"]["edge"]["aliases"]
    assert own == [IN_SWARM["cell.yaml"]["recorder"]["environment"]["RELAY_HOST"]]
    assert networks["web"] <= {"edge", "tunnel", "data"}
    assert networks["nginx"] <= {"edge", "tunnel"}
