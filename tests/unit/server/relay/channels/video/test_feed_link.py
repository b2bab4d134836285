"""The relay's WebSocket to a robot's frames service: what it asks, and what it does when that goes wrong."""

import asyncio

import pytest
from relay_server import until
from robotether_common.frames import MAX_FRAME_BYTES

JPEG = b"\xff\xd8" + b"picture" * 100 + b"\xff\xd9"


async def test_a_connection_on_which_nothing_comes_is_dropped(camera, watch, monkeypatch):
    monkeypatch.setattr("robotether_server.relay.channels.video.feed_link.SILENT_AFTER_S", 0.2)
    monkeypatch.setattr("robotether_server.relay.channels.video.feed_link.CLOCK_SYNC_EVERY_S", 0.05)
    camera.mode = "no_clock_sync"
    viewer = await watch()
    await viewer.text("status", state="down")
    await until(lambda: len(camera.topics) > 1, "it is opened anew")


async def _never_ends(camera):
    """Send a frame in parts, each of which is small (RFC 6455, 5.2)."""
    (socket,) = camera.connections
    part = bytes(2**20)
    for number in range(1 + MAX_FRAME_BYTES // len(part)):
        opcode = b"\x00" if number else b"\x02"
        header = opcode + b"\x7f" + len(part).to_bytes(8, "big")
        socket._req.transport.write(header + part)


async def _floods_with_texts(camera):
    for turn in range(400):
        await camera.send_status(state="live", quality=turn % 100)


@pytest.mark.parametrize(
    ("does", "logged"),
    [
        (lambda camera: camera.send_bytes(b"short"), "broke the frames protocol"),
        (_never_ends, ""),
        (_floods_with_texts, "messages a second"),
    ],
    ids=["no header", "no end", "texts"],
)
async def test_a_robot_that_breaks_the_protocol_is_cut_off(camera, viewer, caplog, does, logged):
    """What the relay holds of it is bounded, and it cannot keep the relay busy."""
    await does(camera)
    await viewer.text("status", state="down")
    await until(lambda: len(camera.topics) > 1, "it is opened anew")
    assert logged in caplog.text


async def test_a_robot_that_cannot_be_reached_again_ends_the_viewers(robot, viewer, monkeypatch):
    monkeypatch.setattr("robotether_server.relay.channels.video.feed_link.AGAIN_WITHIN_S", 0.3)
    await robot._close_ports()
    async with asyncio.timeout(5):
        message = await viewer.socket.receive()
        while message.type.name == "TEXT":
            message = await viewer.socket.receive()
    assert message.data == 4506
    assert "frames_unknown" not in message.extra


async def test_a_robot_that_breaks_off_again_and_again_is_asked_less_often(
    camera, watch, monkeypatch
):
    """Connections that hold for no time must not follow each other without a pause."""
    pauses = []

    async def paused(pause_s):
        pauses.append(pause_s)

    monkeypatch.setattr("robotether_server.relay.channels.video.feed_link.pause", paused)
    await watch()
    for turn in range(1, 5):
        await until(lambda turn=turn: len(camera.topics) == turn, "it is opened anew")
        await camera.send_bytes(b"short")
    await until(lambda: len(pauses) == 4, "it pauses")
    assert pauses == sorted(set(pauses))


async def test_a_connection_that_breaks_is_opened_again(camera, viewer):
    for _ in range(3):
        await viewer.credit()
        await camera.show(JPEG)
        seen = await viewer.frame()
    camera.texts.clear()
    await camera.cut()
    assert "broke" in (await viewer.text("status", state="down"))["detail"]
    await camera.wait_for("credit", frames=2, taken=None)
    camera.sequence = 0
    await viewer.credit()
    await camera.show(JPEG)
    assert (await viewer.frame()).sequence == seen.sequence + 1
    await viewer.credit()
    await camera.wait_for("credit", taken=1)
