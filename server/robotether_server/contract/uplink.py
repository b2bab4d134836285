"""What fills a robot's uplink, as the relay measures it."""

from typing import Annotated, Literal

from msgspec import Meta, Struct

# A camera or a topic of which the robot sends one copy for all; what passes from the robot's own video server as it
# is; what the connections of people and programs to rosbridge bring besides topics.
UplinkKind = Literal["camera", "topic", "video", "rosbridge"]


class UplinkStream(Struct, frozen=True):
    """One stream: bytes a second over the last 1 to 5 s (None: not measured), and who causes it.

    `name`: the topic, empty for `video` and `rosbridge`. `people`: users, each counted once. `yours`: the caller is
    one of them.
    """

    kind: UplinkKind
    name: str
    bytes_per_s: Annotated[int, Meta(ge=0)] | None
    people: Annotated[int, Meta(ge=0)]
    yours: bool


class UplinkObject(Struct, frozen=True):
    """What the robot sends through the relay, the most first.

    `line_bytes_per_s`: what its line carries of video and topics while they fill it, as the robot estimates; None: they
    do not, or it does not say.
    """

    streams: list[UplinkStream]
    line_bytes_per_s: Annotated[int, Meta(ge=0)] | None
