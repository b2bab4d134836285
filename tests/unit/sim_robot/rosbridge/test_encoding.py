"""Messages look on the wire as rosbridge's."""

import json
import math
import struct

import cbor2
from sim_robot.bus import TopicMessage
from sim_robot.messages import MessageTypes
from sim_robot.rosbridge import encoding

TYPES = MessageTypes(2)


def test_json_has_op_topic_and_msg() -> None:
    """A publish frame holds three fields, NaN is null."""
    message = TopicMessage("/a", "std_msgs/Float64", {"data": math.nan})
    frame = encoding.publish_frame(TYPES, message, "/a", encoding.NONE)
    assert json.loads(frame) == {"op": "publish", "topic": "/a", "msg": {"data": None}}


def test_frame_is_encoded_once() -> None:
    """Two clients share the text of one message."""
    message = TopicMessage("/a", "std_msgs/String", {"data": "x"})
    one, other = (encoding.publish_frame(TYPES, message, "/a", encoding.NONE) for _ in range(2))
    assert one is other


def test_topic_is_written_as_the_client_did() -> None:
    """A client that said `a` hears of `a`, another one of `/a`."""
    message = TopicMessage("/a", "std_msgs/String", {"data": "x"})
    frames = [encoding.publish_frame(TYPES, message, topic, encoding.NONE) for topic in ("a", "/a")]
    assert [json.loads(frame)["topic"] for frame in frames] == ["a", "/a"]


def test_cbor_packs_number_arrays() -> None:
    """A covariance is a little-endian float64 typed array (RFC 8746, tag 86), bytes are bytes."""
    values = TYPES.conform("geometry_msgs/PoseWithCovariance", {"covariance": [1.5] * 36}, 0)
    message = TopicMessage("/a", "geometry_msgs/PoseWithCovariance", values)
    frame = encoding.publish_frame(TYPES, message, "/a", encoding.CBOR)
    assert isinstance(frame, bytes)
    packed = cbor2.loads(frame)["msg"]["covariance"]
    assert packed.tag == 86
    assert struct.unpack("<36d", packed.value) == (1.5,) * 36


def test_cbor_keeps_bytes() -> None:
    """uint8[] goes out as bytes, whichever way it came in."""
    for data in ([0, 1, 255], "AAH/"):
        values = TYPES.conform("sensor_msgs/CompressedImage", {"data": data}, 0)
        message = TopicMessage("/a", "sensor_msgs/CompressedImage", values)
        frame = cbor2.loads(encoding.publish_frame(TYPES, message, "/a", encoding.CBOR))
        assert frame["msg"]["data"] == b"\x00\x01\xff"
