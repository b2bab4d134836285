"""Video from a fake robot's web server through the real relay."""

import asyncio

import aiohttp
import pytest
from fake_robot import HOST, JPEG
from relay_server import ANN, until
from robotether_common.frames import QOS
from robotether_server.problems import FieldInvalidError
from robotether_server.relay.channels.video.handler import path_for_robot

STREAM_HEAD = (
    b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace;boundary=b\r\n\r\n--b\r\n"
)


async def test_the_robot_learns_nothing_of_who_asks(
    *, relay, robot, sim1, memory_database, login, video
):
    path = f"snapshot?topic=/a%2Fb&ticket={relay.ticket(sim1)}&q=50"
    headers = login | memory_database.bearer(ANN)
    headers |= {"X-Forwarded-For": "203.0.113.9", "Accept": "image/jpeg"}
    async with video(path, headers) as answer:
        assert answer.status == 200
    seen = robot.video_requests[0]
    assert seen["path"] == "/snapshot?topic=/a/b&q=50&qos_profile=sensor_data"
    assert not {"Cookie", "Authorization", "X-Forwarded-For"} & set(seen["headers"])
    assert seen["headers"]["Accept"] == "image/jpeg"


async def test_video_can_only_be_read(robot, video):
    for method in ("POST", "DELETE", "PUT"):
        async with video("snapshot", method=method) as answer:
            assert (answer.status, (await answer.json())["code"]) == (405, "method_not_allowed")
            assert answer.headers["Allow"] == "GET,HEAD"
    async with video("snapshot", method="HEAD") as answer:
        assert answer.status == 200
    assert [request["method"] for request in robot.video_requests] == ["HEAD"]


async def test_an_offline_robot_has_no_video(video):
    async with video("snapshot") as answer:
        assert (answer.status, (await answer.json())["code"]) == (503, "robot_offline")


CLOSES, STAYS_SILENT, BEGINS_A_STREAM = range(3)


@pytest.fixture
async def silent_server(robot, sim1):
    mood = {"how": CLOSES}

    async def answer(reader, writer):
        await reader.readuntil(b"\r\n\r\n")
        if mood["how"] == BEGINS_A_STREAM:
            writer.write(STREAM_HEAD)
        if mood["how"] != CLOSES:
            await reader.read()
        writer.close()

    await robot._close_ports()
    async with await asyncio.start_server(answer, HOST, sim1.video_port):
        yield mood


@pytest.mark.parametrize("how", [CLOSES, STAYS_SILENT])
async def test_a_still_of_a_topic_without_frames_names_it(
    *, relay, silent_server, sim1, monkeypatch, how, video
):
    monkeypatch.setattr("robotether_server.relay.channels.video.handler.HEADERS_WITHIN_S", 0.3)
    silent_server["how"] = how
    async with video("snapshot?topic=/camera/x") as answer:
        problem = await answer.json()
    assert (answer.status, problem["code"]) == (502, "no_frames")
    why = "no frames from /camera/x: the topic does not exist, nothing publishes it, or too rarely"
    assert problem["detail"] == f"cannot show video of robot sim1: {why}"


async def test_a_server_that_is_down_is_no_missing_topic(relay, robot, silent_server, sim1, video):
    """The robot's own report tells one from the other: its end of the tunnel answers either way."""
    robot.session.send(type="health", ros="ok", video="down", detail="", ros_exposed=False)
    presence = relay.relay.registry.presence
    await until(lambda: presence(sim1.id).video == "down", "it is down")
    async with video("snapshot?topic=/a") as answer:
        assert (answer.status, (await answer.json())["code"]) == (502, "video_down")


async def test_a_stream_that_stays_silent_ends(relay, silent_server, monkeypatch, video):
    """One that is passed through; web_video_server itself would keep it for ever."""
    monkeypatch.setattr("robotether_server.relay.channels.video.handler.SILENT_AFTER_S", 0.3)
    silent_server["how"] = BEGINS_A_STREAM
    async with video("stream?topic=/a&type=png") as answer:
        assert answer.status == 200
        with pytest.raises(aiohttp.ClientError):
            await asyncio.wait_for(answer.read(), 5)
    await until(lambda: relay.relay.connections.count("video") == 0, "the stream has ended")


async def test_an_answer_that_is_none_is_video_down(robot, login, video):
    """A robot that switches protocols opens no pipe to the viewer, nor to nginx."""
    headers = {"Connection": "Upgrade", "Upgrade": "websocket"}
    for status in (b"101 Switching Protocols", b"600 Whatever", b"999 No"):
        head = b"HTTP/1.1 %b\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\r\n" % status
        robot.raw_answer = [head + b"raw bytes"]
        async with video("raw", login | headers) as answer:
            assert (answer.status, (await answer.json())["code"]) == (502, "video_down")
            assert "Upgrade" not in answer.headers
        seen = robot.video_requests[-1]["headers"]
        assert "Upgrade" not in seen
        assert seen.get("Connection", "close") == "close"


ENDS = {
    "tunnel": lambda robot, _: robot.session.close(),
    "right": lambda _, database: database.grants.clear(),
    "login": lambda _, database: database.credentials.clear(),
}


@pytest.mark.parametrize(
    ("end", "by_ticket"), [("tunnel", False), ("right", True), ("login", False), ("login", True)]
)
async def test_a_stream_ends_with_what_it_hangs_on(
    *, relay, robot, sim1, login, memory_database, end, by_ticket, video
):
    """It is cut, and not left hanging; a ticket's stream hangs on the login that asked for the ticket."""
    robot.mode = "port_taken"
    query, headers = (f"?ticket={relay.ticket(sim1)}", {}) if by_ticket else ("", login)
    async with video(f"stream{query}", headers) as answer:
        assert answer.headers["Content-Type"] == "multipart/x-mixed-replace;boundary=frame"
        for _ in range(3):
            await answer.content.readuntil(JPEG)
        assert relay.relay.connections.count("video") == 1
        await relay.relay.fleet.poll()
        done = ENDS[end](robot, memory_database)
        if done is not None:
            await done
        await _read_until_cut(answer)
    await until(lambda: relay.relay.connections.count("video") == 0, "the stream has ended")


async def _read_until_cut(answer):
    async with asyncio.timeout(5):
        with pytest.raises(aiohttp.ClientError):
            await answer.read()


async def test_a_viewer_that_does_not_read_is_bounded_and_ends(relay, robot, monkeypatch, video):
    monkeypatch.setattr("robotether_server.relay.channels.video.handler.VIEWER_SLOW_AFTER_S", 0.5)
    async with video("huge") as answer:
        answer.connection.transport.pause_reading()
        await until(lambda: relay.relay.connections.count("video") == 0, "the viewer is cut")
        assert robot.huge_sent < 40 * 1024 * 1024
        answer.close()


async def test_login_video_without_a_database_says_so(relay, robot, sim1, memory_database, video):
    memory_database.down = True
    async with video("snapshot") as answer:
        assert (answer.status, (await answer.json())["code"]) == (503, "store_unavailable")
    path = f"snapshot?ticket={relay.ticket(sim1)}"
    for _ in range(2):
        async with video(path, {}) as answer:
            assert answer.status == 200


@pytest.mark.parametrize(
    ("path", "query", "expected"),
    [
        ("/robots/sim1/video", "", "/"),
        ("/robots/sim1/video/", "ticket=t", "/"),
        ("/robots/sim1/video/a/b%20c", "x=ticket=1", "/a/b%20c?x=ticket=1"),
        ("/robots/sim1/video/stream", "topic=/a&ticket=t&q=1", f"/stream?topic=/a&q=1&{QOS}"),
        ("/robots/sim1/video/a%2Fb", "topic=%2Fa%2fb%20c", f"/a%2Fb?topic=/a/b%20c&{QOS}"),
        ("/robots/sim1/video/s", "topic=/a&qos_profile=default", "/s?topic=/a&qos_profile=default"),
        *(
            ("/robots/sim1/video/s", f"topic=/a&{name}=t&q=5%300", f"/s?topic=/a&q=5%300&{QOS}")
            for name in ("%74icket", "tick%65t", "%74%69%63%6B%65%74")
        ),
    ],
)
def test_the_robot_is_asked_for_the_rest(path, query, expected):
    assert path_for_robot(path, query) == expected


@pytest.mark.parametrize("side", ["0", "-2", "", "99999", "1" * 20])
def test_no_size_is_asked_for_that_would_fill_the_robots_memory(side):
    path_for_robot("/robots/sim1/video/stream", "topic=/a&width=4096&height=-1")
    with pytest.raises(FieldInvalidError, match="width is 1 to 4096 pixels"):
        path_for_robot("/robots/sim1/video/stream", f"topic=/a&invert&w%69dth={side}")
