"""Reads the messages of a recording, also of one that is still written, or whose recorder was killed."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from mcap.exceptions import McapError
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader


class RecordedTopicMessage(NamedTuple):
    """A message in CDR, with its topic, its type, and the definition of that; times in ns of Unix."""

    topic: str
    type: str
    definition: str
    log_ns: int
    publish_ns: int
    sequence: int
    data: bytes


def read_messages(path: Path) -> Iterator[RecordedTopicMessage]:
    """Yield all messages that were written as a whole, in the order in which they came."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    with path.open("rb") as file:
        try:
            for record in StreamReader(file).records:
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    channels[record.id] = record
                elif isinstance(record, Message):
                    channel = channels[record.channel_id]
                    schema = schemas[channel.schema_id]
                    yield RecordedTopicMessage(
                        channel.topic,
                        schema.name,
                        schema.data.decode(),
                        record.log_time,
                        record.publish_time,
                        record.sequence,
                        record.data,
                    )
        except (McapError, struct.error):
            # The end of what was written.
            return
