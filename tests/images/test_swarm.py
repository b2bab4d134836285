"""A site on Docker Swarm: a node with the database, and two cells; as docs/howto/swarm.md says."""

from __future__ import annotations

import io
import json
import os
import re
import ssl
import tarfile
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from hashlib import sha256

import pytest
from commands import output_of_command
from docker.models.containers import Container
from image_names import ensure_built, image
from local_network import insecure_tls
from swarm import ROOT, Swarm

pytestmark = pytest.mark.release
CELLS = ("a", "b")


@pytest.fixture(scope="module")
def swarm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Swarm]:
    """The whole site, without robots."""
    ensure_built("demo")
    folder = tmp_path_factory.mktemp("swarm")
    secrets = folder / "secrets"
    environ = {**os.environ, "ENV_FILE": "none"}
    output_of_command("tools/site_secrets", "--new", secrets, cwd=ROOT, env=environ)
    with Swarm(folder, secrets, ("database", *CELLS)) as running:
        running.hand_over("database", "mysql", "server")
        for cell in CELLS:
            running.hand_over(cell, "nginx", "server", "sshd")
            running.manager.run(f"docker node update --label-add robotether.cell={cell} {cell}")
        running.manager.run("docker node update --label-add robotether.database=true database")
        running.manager.run(
            "for file in /site-secrets/*; do docker secret create robotether_${file##*/} $file; done"
        )
        running.deploy("robotether", "database.yaml")
        for cell in CELLS:
            deploy_cell(running, cell)
        for stack in ("robotether", "robotether_a", "robotether_b"):
            running.wait(f"{stack} up", lambda stack=stack: running.is_up(stack), seconds=180)
        yield running


def deploy_cell(swarm: Swarm, cell: str) -> None:
    swarm.deploy(
        f"robotether_{cell}", "cell.yaml", CELL=cell, PUBLIC_HOST=swarm.nodes[cell].address
    )


def ask(swarm: Swarm, cell: str, path: str, token: str) -> bytes:
    url = f"https://{swarm.nodes[cell].address}{path}"
    request = urllib.request.Request(url, headers={"Authorization": f"Bearer {token}"})
    try:
        with urllib.request.urlopen(request, timeout=5, context=insecure_tls()) as answer:
            return bytes(answer.read())
    except OSError:
        return b""


def is_online(swarm: Swarm, cell: str, token: str) -> bool:
    answer = ask(swarm, cell, "/api/v1/robots/sim1", token)
    return bool(answer) and bool(json.loads(answer)["online"])


@contextmanager
def robot(swarm: Swarm, cell: str, join_token: str) -> Iterator[Container]:
    """A simulated robot that joins at a cell."""
    address = swarm.nodes[cell].address
    certificate = ssl.PEM_cert_to_DER_cert(ssl.get_server_certificate((address, 443)))
    files = {
        "agent.toml": f'tls_fingerprint = "{sha256(certificate).hexdigest()}"\n',
        "token": join_token,
    }
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as archive:
        for name, text in files.items():
            entry = tarfile.TarInfo(f"etc/robotether/{name}")
            entry.size, entry.mode = len(text), 0o644
            archive.addfile(entry, io.BytesIO(text.encode()))
    container = swarm.engine.containers.create(
        image("sim_robot"), name=f"{swarm.prefix}-sim1", hostname="sim1",
        network=swarm.network.name, mac_address="02:00:00:00:51:01",
        environment={
            "ROBOTETHER_SERVER": f"{address}:443",
            "ROBOTETHER_TOKEN_FILE": "/etc/robotether/token",
            "ROBOTETHER_INTERFACE": "eth0",
            "ROBOTETHER_ALLOW_LOCAL_MAC": "true",
            "SIM_NAME": "sim1",
        },
    )  # fmt: skip
    try:
        assert container.put_archive("/", packed.getvalue())
        container.start()
        yield container
    finally:
        container.remove(force=True, v=True)


def test_parts_of_a_cell_find_each_other(swarm: Swarm) -> None:
    for cell in CELLS:
        address = swarm.nodes[cell].inside(f"robotether_{cell}_sshd", "hostname -i").split()
        found = swarm.nodes[cell].inside(f"robotether_{cell}_relay", "getent ahostsv4 sshd")
        assert {line.split()[0] for line in found.splitlines()} < set(address)


def test_robot_goes_to_the_next_cell(swarm: Swarm) -> None:
    web = partial(swarm.nodes["a"].inside, "robotether_a_web")
    token = web("robotether token create --user admin --name test").split()[-1]
    line = web("robotether robot invite --uses 1 --hours 1 --host cloud")
    [join_token] = re.findall(r"--token (\S+)", line)
    web("robotether robot add sim1 --mac 02:00:00:00:51:01 --allow-local-mac")
    with robot(swarm, "a", join_token) as container:
        for cell in CELLS:
            swarm.wait(f"online at {cell}", lambda cell=cell: is_online(swarm, cell, token))
        swarm.manager.run("docker stack rm robotether_a")
        swarm.wait("gone from a", lambda: not ask(swarm, "a", "/login", token))
        try:
            swarm.wait("online at b alone", lambda: is_online(swarm, "b", token))
        except AssertionError as error:
            error.add_note(container.logs(tail=40).decode())
            raise
        sshd = swarm.nodes["b"].inside("robotether_b_sshd", "ps -u tunnel -o comm=")
        assert "session" in sshd


def test_node_comes_back_by_itself(swarm: Swarm) -> None:
    """After a power cut of the machine of a cell, its services find each other again."""
    node = swarm.nodes["b"]
    node.container.kill()
    status = "docker node ls --filter name=b --format '{{.Status}}'"
    swarm.wait("lost", lambda: swarm.manager.run(status).strip() == "Down")
    node.container.start()
    swarm.wait("back", partial(ask, swarm, "b", "/login", ""), seconds=180)
