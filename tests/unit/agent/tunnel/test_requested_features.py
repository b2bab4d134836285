"""What the server's configuration asks of the agent beside its two tunnels: by itself, and with a real sshd."""

import asyncio
import hashlib
import threading

import pytest
from aiohttp import web
from fake_cloud import echo, eventually
from local_network import free_port
from openssh_server import listens
from robotether_agent.enrolment import keys
from robotether_agent.tunnel import audit_heads
from robotether_agent.tunnel.audit_heads import sign_heads
from robotether_agent.tunnel.session import HeadRequest
from robotether_common.audit_head import NAMESPACE, statement
from robotether_server.signatures import is_signed


async def test_a_shell_is_a_connection_of_its_own(cloud, start_agent, services, caplog):
    caplog.set_level("INFO")
    agent = start_agent(cloud, shell_address=f"127.0.0.1:{services.port}")
    await agent.until_connected()
    assert agent.status().shell_tunnel == "off"
    cloud.configure(shell_port=free_port())
    await agent.until(lambda status: status.shell_tunnel == "open", "the shell tunnel is open")
    assert await echo(cloud.shell_port, "shell") == "shell"
    assert caplog.text.count("connected to") == 1, "other settings are no other connection"
    assert [len(cloud.of_kind(kind, live=False)) for kind in ("session", "media")] == [1, 1]


async def test_shell_that_is_on_again_before_it_has_ended_comes_back(cloud, start_agent, services):
    """The session says off and on before the shell's own connection reads that it ends."""
    cloud.shell_port = free_port()
    agent = start_agent(cloud, shell_address=f"127.0.0.1:{services.port}")
    await agent.until(lambda status: status.shell_tunnel == "open", "the shell tunnel is open")
    shell = await cloud.link("shell")
    cloud.configure(shell_port=None)
    await agent.until(lambda status: status.shell_tunnel == "off", "the shell is off")
    cloud.configure(shell_port=free_port())
    await agent.until(lambda status: status.shell_tunnel == "closed", "the shell is on again")
    shell.send({"type": "bye", "code": "shell_off", "detail": "an admin switched it off"})
    await cloud.link("shell", number=2)
    await agent.until(lambda status: status.shell_tunnel == "open", "the shell tunnel is back")


async def test_video_has_a_connection_while_somebody_watches(cloud, start_agent):
    cloud.media = False
    cloud.shell_port = free_port()
    agent = start_agent(cloud, shell_address="none")
    await agent.until(lambda status: status.video_tunnel == "unwatched", "nobody watches")
    assert agent.status().state == "connected"
    assert cloud.of_kind("media", live=False) == []
    cloud.configure(media=True)
    await agent.until(lambda status: status.video_tunnel == "open", "the video tunnel is open")
    media = await cloud.link("media")
    cloud.configure(media=False)
    media.send({"type": "bye", "code": "unwatched", "detail": "nobody watches"})
    await agent.until(lambda status: status.video_tunnel == "unwatched", "it is closed again")
    await eventually(lambda: not listens(cloud.ports[1]), lambda: "the video port is closed")
    assert agent.status().problem == ""
    cloud.configure(media=True)
    await cloud.link("media", number=2)
    assert len(cloud.of_kind("session", live=False)) == 1
    assert agent.status().shell_tunnel == "off"
    assert cloud.of_kind("shell", live=False) == []


async def test_a_new_key_that_fails_is_told_and_tried_again(cloud, start_agent):
    agent = start_agent(cloud)
    old = (await agent.until_connected()).fingerprint
    refusal = {"code": "robot_disabled", "detail": "it is disabled"}
    cloud.refuses_rotation = lambda: web.json_response(refusal, status=403)
    cloud.configure(rotate_key=True)
    await agent.until(lambda status: "it is disabled" in status.new_key, "the reason is there")
    assert agent.status().state == "connected"
    cloud.configure(rotate_key=False)
    await agent.until(lambda status: not status.new_key, "the reason is gone")
    cloud.configure(rotate_key=True)
    await agent.until(lambda status: "it is disabled" in status.new_key, "the reason is there")
    cloud.refuses_rotation = None
    await agent.until(
        lambda status: status.fingerprint != old and not status.new_key, "the new key"
    )


class Server:
    """The session's other end."""

    def __init__(self):
        self.requests = asyncio.Queue()
        self.answers = asyncio.Queue()

    async def next_head_request(self):
        return await self.requests.get()

    def send(self, message):
        self.answers.put_nowait(message)

    async def ask(self, position, newest=None, chain="sim1", count=1):
        self.requests.put_nowait(HeadRequest(chain, position, f"{position:064x}", newest))
        async with asyncio.timeout(60):
            return [await self.answers.get() for _ in range(count)]


def sha256(answer):
    text = statement(answer["chain"], answer["position"], answer["hash"], answer["previous"])
    return hashlib.sha256(text.encode()).hexdigest()


@pytest.fixture
async def server(tmp_path):
    """The session, with the work of the agent that answers; as after each start of the agent."""
    server = Server()
    work = sign_heads(tmp_path, lambda: keys.ensure_key(tmp_path), server)
    task = asyncio.create_task(work)
    yield server
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


async def test_each_statement_names_the_one_before(server, tmp_path):
    (first,) = await server.ask(3)
    (second,) = await server.ask(7, sha256(first))
    key = await keys.ensure_key(tmp_path)
    for answer, previous in ((first, None), (second, sha256(first))):
        assert answer["previous"] == previous
        text = statement("sim1", answer["position"], answer["hash"], previous)
        assert is_signed(key.public, NAMESPACE, text, answer["signature"])
    (again,) = await server.ask(7, sha256(first))
    assert again == second


async def test_what_the_server_lacks_is_sent_again(server):
    (first,) = await server.ask(3)
    assert (await server.ask(7, count=2))[0] == first
    assert len(await server.ask(9, "0" * 64, count=3)) == 3
    assert (await server.ask(1, chain="other"))[0]["previous"] is None


async def test_log_that_went_back_is_not_signed(server):
    """The robot remembers it also after it had another name meanwhile."""
    (newest,) = await server.ask(7)
    assert await server.ask(3) == [newest]
    await server.ask(1, chain="other")
    assert await server.ask(3) == [newest]
    (next_one,) = await server.ask(8, sha256(newest))
    assert next_one["previous"] == sha256(newest)


async def test_damaged_file_begins_anew(server, tmp_path):
    await server.ask(7)
    (tmp_path / "audit_heads.json").write_text('{"statements": [{}]}')
    (answer,) = await server.ask(8)
    assert (answer["position"], answer["previous"]) == (8, None)


async def test_a_slow_disk_does_not_hold_up_the_agent(server, monkeypatch):
    """A line is signed as a drive ends, and the next driver may have begun."""
    loop, goes_on, waited = asyncio.get_running_loop(), threading.Event(), []

    def write_slowly(*_):
        loop.call_soon_threadsafe(goes_on.set)
        waited.append(goes_on.wait(5))

    monkeypatch.setattr(audit_heads, "write_atomic", write_slowly)
    assert len(await server.ask(3)) == 1
    assert waited == [True]
