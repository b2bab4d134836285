"""The proof at the end of an enrolment, as Ansible runs it, with a server that answers as a test says."""

import ssl
from contextlib import asynccontextmanager

import pytest
from aiohttp import web
from ansible_module import run_module

pytestmark = pytest.mark.release


@asynccontextmanager
async def serving(certificate, answer):
    """A server that gives tickets, and answers at the address that they have as the test says."""

    async def ticket(request):
        assert request.headers["Authorization"] == "Bearer rt_x"
        assert await request.json() == {"robot": "sim1", "mode": "drive"}
        return web.json_response({"ros_url": "/ros?ticket=t"}, status=201)

    app = web.Application()
    app.router.add_post("/api/v1/tickets", ticket)
    app.router.add_get("/ros", answer)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate)
    runner = web.AppRunner(app, access_log=None, shutdown_timeout=0.1)
    await runner.setup()
    await web.TCPSite(runner, "127.0.0.1", 0, ssl_context=context).start()
    try:
        yield f"127.0.0.1:{runner.addresses[0][1]}"
    finally:
        await runner.cleanup()


async def run_round_trip(server, **more):
    """Run the module once on this machine; what it returned."""
    arguments = {"server": server, "token": "rt_x", "name": "sim1", "timeout": 0, **more}
    return await run_module("round_trip", arguments)


async def upgraded(request):
    assert "Origin" not in request.headers
    assert request.query["ticket"] == "t"
    socket = web.WebSocketResponse()
    await socket.prepare(request)
    return socket


async def closes(request):
    socket = await upgraded(request)
    await socket.close(code=4503, message=b"robot sim1 is offline")
    return socket


async def leads_away(_request):
    return web.Response(status=302, headers={"Location": "wss://127.0.0.1:1/"})


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        (closes, "robot sim1 is offline [4503]"),
        (leads_away, "Redirect limit exhausted"),
    ],
)
async def test_a_robot_that_is_not_reached(certificate, answer, why):
    async with serving(certificate, answer) as server:
        result = await run_round_trip(server, ca_file=str(certificate))
    assert result["failed"]
    assert result["code"] == "robot_unreachable"
    assert why in result["msg"]
    assert result["msg"].startswith(f"cannot reach rosbridge of robot sim1 through {server}: ")


async def test_a_certificate_that_is_not_trusted_gets_no_token(certificate):
    async def never(_request):
        raise AssertionError

    async with serving(certificate, never) as server:
        result = await run_round_trip(server)
    assert result["code"] == "tls_untrusted"
