"""How a published message looks on the wire: JSON text or CBOR bytes.

Used by client.py for each message that goes to a client; the result is kept with the message, since several
clients mostly get the same one.
"""

import base64
import json
import struct
from typing import Any

import cbor2

from sim_robot.bus import TopicMessage
from sim_robot.messages import MessageTypes, Values, finite_or_none

NONE, CBOR = "none", "cbor"
COMPRESSIONS = (NONE, CBOR)

# RFC 8746, little-endian: item type -> tag, struct format
_TYPED_ARRAYS = {
    "uint16": (69, "H"),
    "uint32": (70, "I"),
    "uint64": (71, "Q"),
    "int8": (72, "b"),
    "int16": (77, "h"),
    "int32": (78, "i"),
    "int64": (79, "q"),
    "float32": (85, "f"),
    "float64": (86, "d"),
}


def publish_frame(
    types: MessageTypes, message: TopicMessage, topic: str, compression: str
) -> str | bytes:
    """Encode a message for a client that knows the topic as `topic`."""
    known = message.wire.get((topic, compression))
    if known is None:
        known = _encode(types, message, topic, compression)
        message.wire[topic, compression] = known
    return known


def to_json(value: Any) -> str:
    """Write compact JSON; NaN and infinity become null."""
    try:
        return json.dumps(value, separators=(",", ":"), allow_nan=False)
    except ValueError:
        return json.dumps(finite_or_none(value), separators=(",", ":"))


def _encode(
    types: MessageTypes, message: TopicMessage, topic: str, compression: str
) -> str | bytes:
    frame: Values = {"op": "publish", "topic": topic, "msg": message.values}
    if compression == CBOR:
        return cbor2.dumps(frame | {"msg": _cbor_values(types, message.key, message.values)})
    return to_json(frame)


def _cbor_values(types: MessageTypes, key: str, values: Values) -> Values:
    return {
        name: _cbor_field(types, field_type, values[name]) for name, field_type in types.fields(key)
    }


def _cbor_field(types: MessageTypes, field_type: str, value: Any) -> Any:
    item_type, bracket, _ = field_type.partition("[")
    if bracket and item_type == "uint8":
        return base64.b64decode(value)
    if bracket:
        return _cbor_array(types, item_type, value)
    if types.is_message(field_type):
        return _cbor_values(types, field_type, value)
    return value


def _cbor_array(types: MessageTypes, item_type: str, items: list[Any]) -> Any:
    if item_type in _TYPED_ARRAYS:
        tag, code = _TYPED_ARRAYS[item_type]
        return cbor2.CBORTag(tag, struct.pack(f"<{len(items)}{code}", *items))
    return [_cbor_field(types, item_type, item) for item in items]
