"""What fills a robot's uplink, as the relay measures it."""

from typing import Annotated, Literal

from msgspec import Meta, Struct

UplinkKind = Literal["camera", "topic", "video", "rosbridge"]


class UplinkStream(Struct, frozen=True):
    """One stream: bytes a second over the last 1 to 5 s (None: not measured), and who causes it.

    Of a `camera`, and of a `topic` with the same settings, the robot sends one copy for all; copies of a topic are
    added up. `video`: what its web_video_server answers directly. `rosbridge`: what clients' connections carry besides
    topics, such as answers of services. `name`: the topic, empty for `video` and `rosbridge`. `people`: users, each
    counted once. `yours`: the caller is one of them. `recorded`: a recording reads it, too. A message counts while it
    arrives.
    """

    kind: UplinkKind
    name: str
    bytes_per_s: Annotated[int, Meta(ge=0)] | None
    people: Annotated[int, Meta(ge=0)]
    yours: bool
    recorded: bool


class UplinkObject(Struct, frozen=True):
    """What the robot sends through the relay, the most first.

    `line_bytes_per_s`: what its line carries of video and topics while they fill it, as the robot estimates; None: they
    do not, or it does not say.
    """

    streams: list[UplinkStream]
    line_bytes_per_s: Annotated[int, Meta(ge=0)] | None
