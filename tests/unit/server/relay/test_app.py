"""The HTTP border: routes, problems, health and metrics."""

import asyncio
from dataclasses import replace

import pytest
from fake_robot import HOST, WAIT_S
from relay_server import ANN, relay_settings
from robotether_server import __version__
from robotether_server.relay.app import Servers, public_app
from robotether_server.relay.auth.connections import Caps
from robotether_server.relay.channels.rosbridge.bridge import Traffic
from robotether_server.relay.metrics import Metrics
from yarl import URL


async def test_a_defect_is_answered_without_its_details(relay, http, monkeypatch, caplog):
    async def broken(*_args):
        raise ZeroDivisionError("secret detail")

    monkeypatch.setattr("robotether_server.relay.auth.access.Access.for_events", broken)
    async with http.get(f"{relay.url}/api/v1/events") as answer:
        assert answer.status == 500
        assert "secret" not in await answer.text()
    assert "ZeroDivisionError" in caplog.text


@pytest.mark.parametrize("headers", [{"Origin": "https://evil.example"}, {}])
async def test_no_request_writes_a_line_of_its_own(relay, http, caplog, headers):
    """A line break in a path is written as such, and ends no line of the log."""
    caplog.set_level("INFO")
    for path in ("x%0aINFO%20forged/video", "x%0d%0aINFO%20forged/ros"):
        async with http.get(URL(f"{relay.url}/robots/{path}", encoded=True), headers=headers):
            pass
    lines = [text for text in caplog.messages if "forged" in text]
    assert [len(line.splitlines()) for line in lines] == [1, 1]


async def test_a_request_is_logged_as_json_without_its_query(http, caplog):
    caplog.set_level("INFO")
    app = public_app(replace(relay_settings(), log_format="json"), Metrics(Traffic()), ())
    servers = Servers(HOST, backlog=1)
    url = f"http://{HOST}:{await servers.serve(app, 0)}/robots/sim1/ros?ticket=secret"
    async with http.get(url) as answer:
        assert answer.status == 404
    await servers.close()
    [line] = [record.request for record in caplog.records if record.getMessage() == "request"]
    assert line.pop("took_s") < WAIT_S
    assert line == {"method": "GET", "path": "/robots/sim1/ros", "status": 404}


async def ask_raw(relay, request):
    reader, writer = await asyncio.open_connection(HOST, relay.relay.http_port)
    try:
        writer.write(request)
        return await asyncio.wait_for(reader.readline(), WAIT_S)
    finally:
        writer.close()
        await writer.wait_closed()


async def test_bytes_that_are_no_text_are_nobodys(relay, robot, caplog):
    """Whoever shows them as a login or token is refused as with any other that does not hold."""
    for path, header in (
        (b"/api/v1/events", b"Cookie: __Host-robotether_login=\xff\xfe"),
        (b"/robots/sim1/video/snapshot", b"Cookie: \xff=\xff"),
        (b"/api/v1/robots/sim1/control", b"Authorization: \xff"),
    ):
        request = b"GET %b HTTP/1.1\r\nHost: robots.example\r\n%b\r\n\r\n" % (path, header)
        assert (await ask_raw(relay, request)).startswith(b"HTTP/1.1 401 ")
    assert [record for record in caplog.records if record.levelname == "ERROR"] == []


UNREADABLE = [
    b"GET /robots/sim1/ros?ticket=SECRET HTTP/1.1 x\r\nHost: a\r\n\r\n",
    b"GET /robots/sim1/ros?ticket=SECRET\xff HTTP/1.1\r\nHost: a\r\n\r\n",
    b"GET /robots/sim1/ros?ticket=SECRET HTTX/1.1\r\nHost: a\r\n\r\n",
    b"G\xffT /robots/sim1/ros?ticket=SECRET HTTP/1.1\r\nHost: a\r\n\r\n",
    b"GET http://[/robots/sim1/ros?ticket=SECRET HTTP/1.1\r\nHost: a\r\n\r\n",
    b"GET /robots/sim1/ros?ticket=SECRET%b HTTP/1.1\r\nHost: a\r\n\r\n" % (b"x" * 20_000),
    b"GET / HTTP/1.1\r\nHost: a\r\nCookie: a=SECRET\x01\r\n\r\n",
    b"GET / HTTP/1.1\r\nHost: a\r\nSECRET : a\r\n\r\n",
]


async def test_request_that_cannot_be_parsed_stays_out_of_the_log(relay, caplog):
    """A ticket may stand in it, or a login; the log says what kind of error it was."""
    caplog.set_level("DEBUG")
    for request in UNREADABLE:
        assert b" 400 " in await ask_raw(relay, request)
    assert "SECRET" not in caplog.text
    assert caplog.text.count("Error handling request from 127.0.0.1: ") == len(UNREADABLE)


async def test_health_is_good_without_a_database_and_says_so(relay, http, memory_database):
    """A database that is away is no reason to restart the relay, nor is a header that nginx lets through."""
    for down, store in ((False, "up"), (True, "down")):
        memory_database.down = down
        await relay.relay.fleet.poll()
        headers = {"Cookie": "a" * 13_000}
        async with http.get(f"{relay.inside_url}/healthz", headers=headers) as answer:
            assert (answer.status, await answer.json()) == (200, {"status": "ok", "store": store})


@pytest.mark.usefixtures("no_command_is_late")
async def test_metrics_tell_what_happens(relay, robot, http, ros):
    async with ros() as socket:
        await socket.send_str('{"op":"publish","topic":"/cmd_vel","msg":{}}')
        await socket.send_str('{"op":"call_service","service":"/rosapi/topics"}')
        echoes = await socket.receive_str() + await socket.receive_str()
        async with http.get(f"{relay.url}/api/v1/events"):
            pass
        async with http.get(f"{relay.inside_url}/metrics") as answer:
            lines = (await answer.text()).splitlines()
    assert "robotether_relay_drivers 1.0" in lines
    assert 'robotether_relay_messages_total{to="robot"} 2.0' in lines
    assert 'robotether_relay_command_age_seconds_bucket{le="+Inf"} 1.0' in lines
    assert f'robotether_build_info{{cell="main",version="{__version__}"}} 1.0' in lines
    assert f'robotether_relay_message_bytes_total{{to="client"}} {len(echoes)}.0' in lines
    assert 'robotether_relay_refusals_total{code="login_missing"} 1.0' in lines


@pytest.mark.parametrize("path", ["/api/v1/events", "/robots/sim1/video/snapshot"])
async def test_who_has_too_many_connections_gets_no_other(
    *, relay, robot, http, memory_database, path
):
    relay.relay.connections.caps = Caps(per_user=0)
    async with http.get(relay.url + path, headers=memory_database.bearer(ANN)) as answer:
        assert (answer.status, (await answer.json())["code"]) == (429, "too_many_connections")


ALLOWED = {"Origin": "https://lab.example"}
ASKS = {"Access-Control-Request-Method": "POST", "Access-Control-Request-Headers": "authorization"}


async def test_a_page_that_is_allowed_may_ask(relay, http):
    for path in (
        "/api/v1/robots/sim1/stop",
        "/api/v1/robots/sim1/control",
        "/api/v1/robots/sim1/topics/arm/state",
        "/robots/sim1/video/stream",
        "/robots/sim1/video/snapshot",
    ):
        async with http.options(relay.url + path, headers=ALLOWED | ASKS) as answer:
            assert answer.status == 204
            assert answer.headers["Access-Control-Allow-Origin"] == "https://lab.example"
            assert "POST" in answer.headers["Access-Control-Allow-Methods"]
            assert answer.headers["Access-Control-Allow-Headers"] == "Authorization, Content-Type"
            assert "Access-Control-Allow-Credentials" not in answer.headers
            assert answer.headers["Vary"] == "Origin"
        headers = ASKS | {"Origin": "http://lab.example"}
        async with http.options(relay.url + path, headers=headers) as answer:
            assert answer.status == 403
            assert "Access-Control-Allow-Origin" not in answer.headers
        async with http.options(relay.url + path, headers=ALLOWED) as answer:
            assert answer.status == 405, "it is no preflight"
    for path in ("/api/v1/stop", "/api/v1/events", "/robots/sim1/ros"):
        async with http.options(relay.url + path, headers=ASKS | ALLOWED) as answer:
            assert answer.status == 405
            assert "Access-Control-Allow-Origin" not in answer.headers


async def test_an_allowed_page_acts_with_its_token_as_a_program_does(
    relay, robot, http, memory_database
):
    for origin, allowed in (({}, None), (ALLOWED, "https://lab.example")):
        headers = origin | memory_database.bearer(ANN)
        for name, status in (("sim1", 200), ("nosuch", 404)):
            url = f"{relay.url}/api/v1/robots/{name}/stop"
            async with http.post(url, headers=headers) as answer:
                assert answer.status == status
                assert answer.headers.get("Access-Control-Allow-Origin") == allowed
                assert answer.headers["Vary"] == "Origin"
