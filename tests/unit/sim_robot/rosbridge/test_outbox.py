"""What waits for a client is bounded."""

import asyncio

from sim_robot.rosbridge.outbox import Outbox


async def take_all(outbox: Outbox) -> list[str | bytes]:
    """Take what waits."""
    return [await outbox.get() for _ in range(len(outbox))]


async def test_order_is_kept() -> None:
    """Messages and replies come out as they went in."""
    outbox = Outbox()
    outbox.put_message("a")
    outbox.put_reply("b")
    outbox.put_message("c")
    assert await take_all(outbox) == ["a", "b", "c"]


async def test_oldest_messages_make_room() -> None:
    """When it is full, the oldest topic message goes, never a reply."""
    outbox = Outbox(messages_limit=3)
    outbox.put_reply("reply")
    for number in range(5):
        outbox.put_message(str(number))
    assert (outbox.dropped, outbox.overflowed) == (3, False)
    assert await take_all(outbox) == ["reply", "3", "4"]


async def test_bytes_are_bounded_too() -> None:
    """Few large messages make room for each other; one alone passes whatever its size."""
    outbox = Outbox(bytes_limit=100)
    for letter in "abc":
        outbox.put_message(letter * 60)
    assert await take_all(outbox) == ["c" * 60]
    outbox.put_message("x" * 500)
    assert len(outbox) == 1


async def test_replies_that_nobody_reads_overflow() -> None:
    """When replies alone fill it, that is told, and nothing more is kept."""
    outbox = Outbox(messages_limit=3)
    for number in range(10):
        outbox.put_reply(str(number))
    assert outbox.overflowed
    assert len(outbox) == 4


async def test_get_waits() -> None:
    """An empty one makes its reader wait for the next entry."""
    outbox = Outbox()
    waiting = asyncio.create_task(outbox.get())
    await asyncio.sleep(0)
    assert not waiting.done()
    outbox.put_message("late")
    assert await asyncio.wait_for(waiting, 1) == "late"
