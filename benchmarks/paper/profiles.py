"""The networks that robots and operators are put behind: those of the paper's Table 2, and worse ones.

A profile is what one end (a robot or an operator) has between itself and the server. The paper gives ping in ms, down-
and uplink in Mbit/s; half of the ping is each way's delay. Which rows are fixed lines and which 4G is told by their
ping and rates, as the paper's own page does.
"""

from __future__ import annotations

from dataclasses import dataclass

from link import Shape

# What a home router or a base station keeps for one user, at least; and half a second of what the link carries.
LEAST_QUEUE_BYTES, QUEUE_S = 64 * 1024, 0.5


@dataclass(frozen=True, kw_only=True)
class Profile:
    """One network; `None` for a rate is as fast as this machine is."""

    name: str
    ping_ms: float = 0.0
    down_mbit_s: float | None = None
    up_mbit_s: float | None = None
    # Each packet is up to this much later or earlier, in order.
    jitter_ms: float = 0.0
    # The share of packets that is lost, each way.
    loss: float = 0.0

    @property
    def is_plain(self) -> bool:
        """Whether nothing is emulated."""
        return self == Profile(name=self.name)

    @property
    def up(self) -> Shape:
        """From the robot's or operator's end to the server."""
        return self._shape(self.up_mbit_s)

    @property
    def down(self) -> Shape:
        """From the server to that end."""
        return self._shape(self.down_mbit_s)

    def _shape(self, mbit_s: float | None) -> Shape:
        rate_bit_s = None if mbit_s is None else mbit_s * 1e6
        queue = LEAST_QUEUE_BYTES if rate_bit_s is None else int(rate_bit_s / 8 * QUEUE_S)
        return Shape(
            rate_bit_s=rate_bit_s,
            delay_s=self.ping_ms / 2000,
            jitter_s=self.jitter_ms / 2000,
            queue_bytes=max(LEAST_QUEUE_BYTES, queue),
            loss=self.loss,
        )


PLAIN = Profile(name="no emulation")
TABLE_2 = (
    Profile(name="fixed, 94/89 Mbit/s", ping_ms=7, down_mbit_s=94.41, up_mbit_s=89.44),
    Profile(name="fixed, 288/113 Mbit/s", ping_ms=7, down_mbit_s=287.77, up_mbit_s=113.18),
    Profile(name="4G, 7/5 Mbit/s", ping_ms=38, down_mbit_s=7.13, up_mbit_s=4.97),
    Profile(name="4G, 31/9 Mbit/s", ping_ms=19, down_mbit_s=31.13, up_mbit_s=8.91),
    Profile(name="4G, 80/19 Mbit/s", ping_ms=15, down_mbit_s=80.07, up_mbit_s=19.36),
    Profile(name="4G, 5.4/5.4 Mbit/s", ping_ms=31, down_mbit_s=5.41, up_mbit_s=5.36),
)
FIXED, FAST_FIXED, SLOW_4G, GOOD_4G, FAST_4G, OTHER_4G = TABLE_2
# A third each, as the mixed runs want.
MIXED = (FIXED, SLOW_4G, OTHER_4G)
# Round trips of 80 ± 20 ms with 2 % loss, and 300 ± 100 ms with 10 % and 500 kbit/s.
LOSSY = Profile(name="80 ± 20 ms, 2 % loss", ping_ms=80, jitter_ms=20, loss=0.02)
WORST = Profile(
    name="300 ± 100 ms, 10 % loss, 500 kbit/s",
    ping_ms=300,
    jitter_ms=100,
    loss=0.1,
    down_mbit_s=0.5,
    up_mbit_s=0.5,
)
