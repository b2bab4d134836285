"""The channel of the stack's recorder, and its tickets: what they open, and whom they leave alone."""

import secrets

from fake_robot import WAIT_S
from frames_viewer import FramesViewer
from relay_clients import refusal
from relay_server import TICKET_KEY, until
from robotether_server.db.fleet import RECORDER
from robotether_server.relay.channels.rosbridge.shared_topics import MAX_OBSERVED_TOPICS
from robotether_server.tickets import RECORDER_SALT, Ticket, TicketSigner


def recorder_ticket(robot=None, mode="observe"):
    number, name = (0, "") if robot is None else (robot.id, robot.name)
    fields = (RECORDER.id, RECORDER.name, number, name, mode, "token", "0" * 64)
    return TicketSigner(TICKET_KEY, 30, RECORDER_SALT).sign(Ticket(secrets.token_hex(16), *fields))


async def test_a_user_cannot_open_the_recorders_channel(relay, sim1, http):
    url = f"{relay.inside_url}/recorder?ticket="
    forged = TicketSigner(TICKET_KEY, 30).sign(
        Ticket(
            secrets.token_hex(16), RECORDER.id, "recorder", 7, "sim1", "observe", "token", "0" * 64
        )
    )
    for ticket in ("", "x", relay.ticket(sim1), relay.ticket(sim1, "observe"), forged):
        assert await refusal(http, url + ticket) == 401
    ticket = recorder_ticket()
    async with http.ws_connect(url + ticket):
        assert await refusal(http, url + ticket) == 401
    assert await refusal(http, f"{relay.url}/recorder?ticket={recorder_ticket()}") == 404


async def test_a_recorders_ticket_opens_one_robot_once_and_never_drives(
    memory_database, relay, robot, sim1, http
):
    other = memory_database.add_robot(8, "sim2")
    await until(lambda: "sim2" in relay.relay.fleet.snapshot().by_name, "sim2 is known")
    assert await refusal(http, f"{relay.url}/robots/sim2/ros?ticket={recorder_ticket(sim1)}") == 401
    ticket = recorder_ticket(sim1, "drive")
    async with http.ws_connect(f"{relay.url}/robots/sim1/ros?ticket={ticket}") as socket:
        await socket.send_json({"op": "publish", "topic": "/cmd_vel", "msg": {"linear": {"x": 1}}})
        assert "cannot" in (await socket.receive_json())["msg"]
        assert relay.relay.control.driver(7) is None
    assert await refusal(http, f"{relay.url}/robots/sim1/ros?ticket={ticket}") == 401
    assert other.id not in {each.id for each in relay.relay.registry.robots() if each.connections}
    assert not [text for text in robot.received if b"cmd_vel" in text.encode()]


async def test_an_observer_who_asks_for_everything_leaves_the_recorder_its_topics(
    relay, robot, sim1, http, ros
):
    url = f"{relay.url}/robots/sim1/ros?ticket={recorder_ticket(sim1)}"
    async with ros("observe") as observer, http.ws_connect(url) as recorder:
        for number in range(MAX_OBSERVED_TOPICS + 1):
            await observer.send_json({"op": "subscribe", "topic": f"/t{number}"})
        while "you alone have" not in (await observer.receive_json(timeout=WAIT_S)).get("msg", ""):
            pass
        odometry = {"op": "subscribe", "topic": "/odom"}
        await recorder.send_json(odometry)
        assert await recorder.receive_json(timeout=WAIT_S) == odometry


async def test_the_recorder_neither_wants_more_nor_sets_the_pace(
    *, relay, camera, viewer, sim1, http
):
    """Of a camera that somebody follows."""
    asked = camera.of("stream_request")[-1]
    query = f"topic=/a&ticket={recorder_ticket(sim1)}"
    recorder = FramesViewer(
        await http.ws_connect(f"{relay.url}/robots/{sim1.name}/video/frames?{query}")
    )
    await recorder.ask(quality_max=100, fps=60)
    await recorder.credit(2)
    given = len(camera.of("credit"))
    await camera.show(b"one")
    assert (await recorder.frame()).jpeg == b"one"
    await recorder.credit()
    # Its answer shows that the credit was read.
    await recorder.socket.send_json({"op": "clock_sync", "t_ms": 1})
    await recorder.socket.receive_json()
    assert camera.of("stream_request")[-1] == asked
    assert len(camera.of("credit")) == given
    await viewer.socket.close()
    await camera.wait_for("stream_request", quality_max=100, fps=60)
    await until(lambda: len(camera.of("credit")) > given, "it sets the pace, alone")
    await recorder.socket.close()
