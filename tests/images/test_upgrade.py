"""`docker compose pull && docker compose up -d` over a stack of the release before, with images from a registry.

The stack before is made by that release's own sources, images and tools, with robots, people and tokens.
"""

import os
from urllib.request import urlopen

import docker
import pytest
from attackers import Person
from commands import output_of_command
from image_names import image
from local_network import free_port
from openssh_server import wait_until
from program_driver import ProgramDriver
from sim_watch import SimWatch
from stack import PROJECT, ROOT, Stack, wait_until_back

# Main before the first release.
FIRST = "11d2e22"
RUN = ("mysql", "sshd", "nginx", "server", "sim_robot")
SERVICES = ("nginx", "web", "relay", "sshd", "mysql")
SIMS = ("sim1", "sim2", "sim3")
UP_WITHIN_S = 600

pytestmark = pytest.mark.release


def run(*command, cwd=ROOT):
    return output_of_command(*command, cwd=cwd, limit_s=UP_WITHIN_S)


def answers(url):
    try:
        urlopen(url, timeout=1).close()
    except OSError:
        return False
    return True


def release_before():
    """The newest tag before this commit."""
    found = run("git", "tag", "--list", "v*", "--merged", "HEAD^", "--sort=-creatordate")
    return next(iter(found.split()), FIRST)


@pytest.fixture
def registry():
    """A registry on this machine alone, with the images of these sources as `next`, which the engine no longer has."""
    run("tools/build", "registry")
    port = free_port()
    engine = docker.from_env()
    container = engine.containers.run(
        image("registry"), detach=True, read_only=True, cap_drop=["ALL"], init=True,
        ports={"5000/tcp": ("127.0.0.1", port)}, volumes=["/var/lib/registry"],
    )  # fmt: skip
    try:
        # The engine accepts at the port before the registry does.
        wait_until(lambda: answers(f"http://127.0.0.1:{port}/v2/"), lambda: "the registry answers")
        for name in RUN:
            there = f"127.0.0.1:{port}/robotether/{name}:next"
            run("docker", "tag", image(name), there)
            run("docker", "push", "--quiet", there)
            run("docker", "image", "rm", there)
        yield f"127.0.0.1:{port}/"
    finally:
        container.remove(force=True, v=True)
        engine.close()


@pytest.fixture
def old_stack(tmp_path):
    """The release before, running, with three robots."""
    sources = tmp_path / "sources"
    sources.mkdir()
    run("git", "archive", f"--output={tmp_path / 'sources.tar'}", release_before())
    run("tar", "-xf", tmp_path / "sources.tar", cwd=sources)
    tag = f"before-{os.getpid()}"
    stack = Stack(
        tmp_path / "site", project=f"{PROJECT}-old", root=sources,
        variables={"TAG": tag}, is_built=False,
    )  # fmt: skip
    try:
        stack.up()
        yield stack
    finally:
        stack.root = ROOT
        stack.down()
        names = run("docker", "images", "--format", "{{.Repository}}:{{.Tag}}").split()
        run("docker", "image", "rm", *(name for name in names if name.endswith(f":{tag}")))


def identity(stack):
    """What must be the same afterwards: the server's keys and the robots' rows."""
    kept = ("name", "mac", "state", "ros_port", "video_port", "shell_port", "settings")
    robots = stack.admin.ask("GET", "/robots")["robots"]
    ssh = stack.exec("sshd", "sh", "-c", "cat /etc/ssh/public/*.pub")
    tls = stack.exec("nginx", "cat", "/etc/nginx/tls/cert.pem")
    return {
        "ssh": ssh,
        "tls": tls,
        "robots": [{key: robot[key] for key in kept} for robot in robots],
    }


def test_pull_and_up_upgrade_the_release_before(old_stack, registry):
    """Pulled images take over data, keys and secrets; people, tokens and robots go on, and a robot can be driven."""
    stack = old_stack
    ann = Person(stack, "ann", ("sim1", "drive"))
    before = identity(stack)
    stack.root = ROOT
    stack.variables = {"REGISTRY": registry, "TAG": "next", "COMPOSE_PROFILES": "demo"}
    stack.compose("pull", timeout=UP_WITHIN_S)
    stack.compose("up", "--detach", timeout=UP_WITHIN_S)
    for service in SERVICES:
        stack.wait_healthy(service)
        [tag] = [tag for tag in stack.container(service).image.tags if tag.startswith(registry)]
        assert tag.endswith(":next")
    wait_until_back(stack, *SIMS)
    for robot in before["robots"]:
        # What these releases did not limit, the migration to blind limits leaves as it was.
        robot["settings"].setdefault("guard", {"blind_deg": None, "blind_m": None})
    assert identity(stack) == before
    applied = {name for [name] in stack.sql("SELECT name FROM schema_migrations")}
    assert applied == {file.stem for file in (ROOT / "sql").glob("*.sql")}
    assert ann.cookie
    with SimWatch(stack, "sim1") as watch, ProgramDriver(ann.program.url("sim1")):
        watch.wait_seen("driven", lambda pose: pose["linear_velocity"] > 0, since=0)
