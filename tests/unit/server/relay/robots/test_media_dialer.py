"""How the relay comes to a robot's media services, and what people read when it does not."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from aiohttp import web
from aiohttp.test_utils import TestServer
from robotether_common.guard import REASON_HEADER
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import ConnectionClosedError
from robotether_server.relay.http.sockets import robot_client
from robotether_server.relay.robots.media_dialer import MediaDialer, MediaPath
from robotether_server.relay.robots.robot import Presence

REGISTRY = SimpleNamespace(online_presence=lambda _: Presence(online=True))
TOPICS = MediaPath(
    "/topics", {}, 1024, close_reasons.topics_unknown("sim1"), close_reasons.topics_down
)


@pytest.mark.parametrize(
    ("own_words", "says"),
    [
        ({REASON_HEADER: "rosbridge does not answer"}, "rosbridge does not answer"),
        ({}, "it answered HTTP 502"),
        ({REASON_HEADER: "\u202e"}, "it answered HTTP 502"),
    ],
)
async def test_a_robot_that_refuses_is_asked_ever_more_seldom_and_says_why(sim1, own_words, says):
    asked = 0

    async def refuse(_):
        nonlocal asked
        asked += 1
        return web.Response(status=502, headers=own_words)

    app = web.Application()
    app.router.add_get("/topics", refuse)
    async with TestServer(app) as server, robot_client() as client:
        dialer = MediaDialer(client, "127.0.0.1", REGISTRY)
        with pytest.raises(ConnectionClosedError, match=f"sim1 sends no topics: {says}"):
            await dialer.open(replace(sim1, video_port=server.port), TOPICS, within_s=0.8)
    # With a pause that stays as it was in the beginning there would be 16; the loop's clock has whole milliseconds.
    assert 1 < asked <= 8
