"""What the robot signs of the server's audit log, with its own key and the real ssh-keygen."""

import asyncio
import hashlib

import pytest
from robotether_agent.enrolment import keys
from robotether_agent.tunnel.audit_heads import sign_heads
from robotether_agent.tunnel.session import HeadRequest
from robotether_common.audit_head import NAMESPACE, statement
from robotether_server.signatures import is_signed


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
    (newest,) = await server.ask(7)
    assert await server.ask(3) == [newest]


async def test_damaged_file_begins_anew(server, tmp_path):
    await server.ask(7)
    (tmp_path / "audit_heads.json").write_text('{"statements": [{}]}')
    (answer,) = await server.ask(8)
    assert (answer["position"], answer["previous"]) == (8, None)
