"""Two cells of one site: one database over TLS, one set of secrets, and robots that move from one to the other."""

import asyncio
import json
import ssl
import urllib.error
import urllib.request
from contextlib import contextmanager
from http import HTTPStatus

import aiohttp
import pytest
from cells import first_cell, second_cell
from inside import run_inside
from local_network import insecure_tls
from programs import Program, drive_forward, open_echo

TOPIC = "/camera/image_raw"


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    cell = first_cell(tmp_path_factory.mktemp("site"))
    try:
        cell.up()
        yield cell
    finally:
        cell.down()


@pytest.fixture(scope="module")
def second(first):
    with second_cell(first) as cell:
        yield cell


def host_key(cell):
    return cell.exec("sshd", "cat", "/etc/ssh/public/ssh_host_ed25519_key.pub").split()[1]


def test_cells_are_one_site(first, second):
    first.robotether("user", "add", "ann")
    assert "ann" in second.robotether("user", "list")
    assert host_key(first) == host_key(second)
    token = {"Authorization": f"Bearer {first.token('cells')}"}
    for cell in (first, second):
        status, robots = cell.request("GET", "/api/v1/robots", headers=token)
        assert status == HTTPStatus.OK
        assert {robot["name"] for robot in robots["robots"]} == {"sim1", "sim2", "sim3"}


def test_migrations_run_from_a_cell_too(second):
    assert "nothing was missing" in second.compose("run", "--rm", "--no-TTY", "migrate")


def test_key_look_up_works_at_both(first, second):
    """By TLS, and with the program of people's keys too, which asks by another client."""
    [[fingerprint]] = first.sql("SELECT fingerprint FROM tunnel_keys LIMIT 1")
    for cell in (first, second):
        done = run_inside(
            cell.container("sshd"),
            *("/usr/lib/robotether/authorized-keys", "tunnel", fingerprint, "192.0.2.7 1 2 3"),
            user="keylookup",
        )
        assert (done.returncode, done.stdout[:9]) == (0, "restrict,")
        assert "jump-watch" not in cell.logs("sshd")


def test_database_takes_no_connection_without_tls(first, second):
    host, port = first.settings["DB_HOST"], first.settings["DB_PORT"]
    command = ["mariadb", f"--host={host}", f"--port={port}", "--user=keylookup", "--skip-ssl"]
    read = 'MYSQL_PWD=$(cat /run/secrets/mysql_keylookup_password) exec "$@"'
    done = run_inside(
        second.container("sshd"),
        "sh",
        "-c",
        read,
        "sh",
        *command,
        "-e",
        "SELECT 1",
        user="keylookup",
    )
    assert done.returncode != 0
    assert "secure transport" in done.stderr


def wait_at(first, cell, *robots):
    query = (
        "SELECT cell FROM robot_sessions JOIN robots ON robots.id = robot_id"
        " WHERE name = '{}' AND ended_at IS NULL ORDER BY robot_sessions.id DESC LIMIT 1"
    )

    def are_there():
        return all(first.sql(query.format(robot)) == [[cell]] for robot in robots)

    first.wait(f"{robots} at {cell}", are_there, "relay", *robots, seconds=60)
    for robot in robots:
        first.wait_until_drivable(robot)


def test_robot_goes_to_its_region_when_it_next_connects(first, second):
    """It is told where that is, and stays where it is until then."""
    kept = ("cat", "/var/lib/robotether-agent/enrolment.json")

    def next_port():
        return int(json.loads(first.exec("sim1", *kept))["ssh"]["cells"][0]["ports"][0])

    first.robotether("robot", "set", "sim1", "region=at-b")
    first.wait("sim1 knows", lambda: next_port() == second.ssh_port, "relay", "sim1")
    wait_at(first, "a", "sim1")
    first.robotether("robot", "move-ports", "sim1")
    wait_at(first, "b", "sim1")
    first.robotether("robot", "set", "sim1", "region=null")


@contextmanager
def machine_down(cell):
    """The machine is away inside the block, without a word, and boots after it."""
    containers = [cell.container(name) for name in ("nginx", "web", "relay", "sshd", "mysql")]
    for container in containers:
        container.kill()
    try:
        yield
    finally:
        for container in reversed(containers):
            container.start()
        cell.wait_healthy("mysql")
        cell.wait_healthy("relay")


def robots_at(cell):
    """How many are online there, as its relay counts them, which needs no database."""
    read = "import urllib.request as r; print(r.urlopen('http://127.0.0.1:9100/metrics').read().decode())"
    [line] = [
        item
        for item in cell.exec("relay", "python3", "-c", read).splitlines()
        if item.startswith("robotether_relay_robots_online ")
    ]
    return round(float(line.split()[1]))


def test_robots_of_a_machine_that_died_go_to_the_other(first, second):
    robots = ("sim1", "sim2", "sim3")
    # By itself within a minute.
    second.exec("sshd", "/usr/lib/robotether/authorized-keys", "cache", user="keylookup")
    with machine_down(first):
        second.wait(
            "all robots", lambda: robots_at(second) == len(robots), "relay", "sshd", seconds=60
        )
    for robot in robots:
        second.wait(f"{robot} recorded", lambda robot=robot: second.online(robot), "relay", "web")
    assert robots_at(second) == len(robots)


def test_robots_leave_a_cell_whose_relay_died(first, second):
    """The session command says so through sshd, which would let them in again."""
    relay, robots = second.container("relay"), ("sim1", "sim2", "sim3")
    relay.kill()
    try:
        first.wait("all robots", lambda: robots_at(first) == len(robots), "relay", "sshd")
    finally:
        relay.start()
        second.wait_healthy("relay")
    for robot in robots:
        assert "[relay_lost]" in first.container(robot).logs().decode()


@pytest.fixture(scope="module")
def program(first, second):
    """The admin's program, which opens cell a alone, while all robots are at cell b."""
    token = first.token("forwarding")
    first.robotether("cell", "drain", "a")
    wait_at(first, "b", "sim1", "sim2", "sim3")
    return Program(first, token)


def control(cell, robot):
    return dict(cell.admin.ask("GET", f"/robots/{robot}/control"))


async def test_robot_of_another_cell_is_driven(program, first):
    """The drive is recorded with the client's address, as web has it, which no cell is between."""
    assert await drive_forward(program, "sim1") > 0.4
    asked_web = (
        "SELECT DISTINCT address FROM audit_events WHERE kind = 'token_created'"
        " AND JSON_VALUE(details, '$.token') = 'forwarding'"
    )
    drove = "SELECT DISTINCT address FROM drives WHERE robot = 'sim1'"

    def is_recorded():
        return bool(addresses := first.sql(drove)) and addresses == first.sql(asked_web)

    await asyncio.to_thread(first.wait, "the drive with its address", is_recorded, "relay")


def test_its_video_is_seen(program):
    picture = f"/robots/sim1/video/snapshot?topic={TOPIC}"
    program.stack.wait("a picture", lambda: program.stack.admin.sees(picture))


def test_it_is_stopped_and_released_there(program, first, second):
    stopped = first.admin.ask("POST", "/robots/sim1/stop", {"reason": "x" * 250})["stopped"]
    assert (stopped["by"], stopped["confirmed"]) == ("admin", True)
    [[reason]] = first.sql("SELECT reason FROM robot_stops")
    assert reason == "x" * 250
    assert control(second, "sim1")["stopped"] == stopped
    assert first.admin.ask("POST", "/robots/sim1/release")["stopped"] is None
    assert first.sql("SELECT * FROM robot_stops") == []


async def test_ticket_opens_one_connection_at_all_cells(program, second):
    """The robot's cell burns it, whichever was asked."""
    ticket = await asyncio.to_thread(program.ticket, "sim1", "observe")
    async with program.connect("sim1", ticket=ticket) as socket:
        await socket.send_json({"op": "robotether.clock_sync", "t_ms": 1.0})
    for cell in (program.stack, second):
        with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
            async with Program(cell, "").connect("sim1", ticket=ticket):
                pass
        assert refused.value.status == 401


async def test_pages_of_the_asked_cell_alone_may_drive(program, second):
    """The robot's cell compares a page's origin with the host that was asked."""
    async with program.connect("sim1", origin=program.stack.url) as socket:
        await open_echo(socket)
    with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
        async with program.connect("sim1", origin=second.url):
            pass
    assert refused.value.status == 403


def test_peer_listener_accepts_cells_alone(first, second):
    """Nobody without the site's certificate gets an answer from the relay."""
    url = f"https://{second.settings['PEER_ADDRESS']}/api/v1/robots/sim1/control"
    context = insecure_tls()
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(url, timeout=5, context=context)
    with refused.value as error:
        assert error.code == 400
        assert b"certificate" in error.read()


async def test_robot_of_a_cell_that_dies_is_driven_at_another(program, first, second):
    """A stop that was on its way to the dead cell begins here, and is in force when the robot comes."""
    first.robotether("cell", "resume", "a")
    for service in ("nginx", "relay", "sshd", "web"):
        second.container(service).kill()
    status, answer = first.admin.try_to("POST", "/robots/sim1/stop")
    assert (status, answer["stopped"]["by"]) == (200, "admin")
    wait_at(first, "a", "sim1")
    first.wait("it is stopped", lambda: (control(first, "sim1")["stopped"] or {}).get("confirmed"))
    assert first.admin.ask("POST", "/robots/sim1/release")["stopped"] is None
    assert await drive_forward(program, "sim1") > 0.4
