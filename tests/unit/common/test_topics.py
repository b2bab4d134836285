"""What waits of a topic for a receiver, and what tells its messages apart."""

import cbor2
import pytest
from robotether_common.topics import FRESH_BYTES, MAX_WAITING_BYTES, MessageQueue, digest


def taken(queue):
    """Empty the queue."""
    return [queue.pop()[0] for _ in range(len(queue))]


def test_a_burst_of_small_messages_waits_whole():
    """Who comes next in the same turn of the loop drops nothing."""
    queue = MessageQueue(0)
    for number in range(200):
        queue.push(b"%d" % number, "text", 0.0)
    assert taken(queue) == [b"%d" % number for number in range(200)]


def test_what_is_old_goes_where_more_waits_than_a_line_soon_takes():
    queue = MessageQueue(0)
    for second in range(10):
        queue.push(b"%d" % second * FRESH_BYTES, "text", float(second))
    assert taken(queue) == [b"9" * FRESH_BYTES]


def test_the_newest_stays_however_large_it_is():
    queue = MessageQueue(0)
    for digit in (b"1", b"2"):
        queue.push(digit * MAX_WAITING_BYTES, "text", 0.0)
    assert [message[:1] for message in taken(queue)] == [b"2"]


def test_a_queue_that_was_requested_keeps_its_length():
    queue = MessageQueue(3)
    for second in range(10):
        queue.push(b"%d" % second * FRESH_BYTES, "text", float(second))
    assert [message[:1] for message in taken(queue)] == [b"7", b"8", b"9"]


@pytest.mark.parametrize("secs", [7, 2**31])
def test_a_raw_message_is_the_same_whenever_rosbridge_got_it(secs):
    def raw(content, **time):
        msg = {**time, "bytes": content}
        return cbor2.dumps({"op": "publish", "topic": "/" + "a" * 254, "msg": msg})

    first = digest(raw(b"map", secs=0, nsecs=0))
    assert digest(raw(b"map", secs=secs, nsecs=999_999_999)) == first
    assert digest(raw(b"mop", secs=0, nsecs=0)) != first
    assert digest(raw(b"map", secs=0)) != digest(raw(b"map", secs=1)), "another type's members"
