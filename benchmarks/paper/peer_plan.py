"""What is compared in peers.py, how long each way is measured, and what its steps are called. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from paper.profiles import SLOW_4G
from paper.step import Scale

LINK = SLOW_4G
OURS, STRAIGHT, SSH = "robotether", "straight", "ssh"
# In the page's order.
TITLES: Mapping[str, str] = {
    STRAIGHT: "straight rosbridge, no tunnel",
    SSH: "bare ssh -R, autossh",
    "wireguard": "WireGuard in user space",
    "openvpn": "OpenVPN, UDP",
    "nebula": "nebula",
    OURS: "Robotether",
}
# web_video_server's own quality, which makes more than the link takes, and one that fits.
DEFAULT_QUALITY, FITTING_QUALITY = "quality 95", "quality 80"
FRAMES = "frames protocol"
LATENCY, LOAD, CHANGES, PATIENCE = "latency", "load", "changes", "patience"
# For what is measured at each step, in seconds; for the progress bar alone.
EXPECTED_S = {LATENCY: 50.0, LOAD: 12.0, CHANGES: 30.0, PATIENCE: 120.0}
# Some wait for their keep-alives, or are given up.
LONG_CHANGES_S = {SSH: 140.0, "wireguard": 95.0}
QUICK_S = 14.0


@dataclass(frozen=True, kw_only=True)
class Plan:
    """How much is measured."""

    transports: Sequence[str] = tuple(TITLES)
    measures: Sequence[str] = (LATENCY, LOAD, CHANGES)
    # Of round trips, idle and behind each video; and until a video fills what it fills.
    seconds: float = 10.0
    settle_s: float = 5.0
    # How many of a way's videos are looked at.
    videos: int = 2
    load_s: float = 6.0
    load_settle_s: float = 2.0
    connects: int = 5
    recovers: int = 5
    # Each of a bare `ssh -R`'s takes a minute, and one for which the operator waits takes two.
    ssh_recovers: int = 2

    def recovers_of(self, key: str) -> int:
        """How often a way's robot gets another address."""
        return self.ssh_recovers if key == SSH else self.recovers

    def expected_s(self, key: str, measure: str) -> float:
        """About how long a step takes."""
        if self != Plan():
            return QUICK_S
        usual_s = EXPECTED_S[measure]
        return LONG_CHANGES_S.get(key, usual_s) if measure == CHANGES else usual_s

    def steps(self) -> list[tuple[str, str]]:
        """Way and measure of each step; all ways of one measure stand together, as they are compared."""
        every = [(key, measure) for measure in self.measures for key in self.transports]
        return every + ([(SSH, PATIENCE)] if CHANGES in self.measures else [])


def plan_of(scale: Scale) -> Plan:
    """What a run of this scale measures."""
    if not scale.quick:
        return Plan()
    transports = (STRAIGHT, SSH, OURS)
    return Plan(transports=transports, measures=(LATENCY,), seconds=3.0, settle_s=2.0, videos=1)


def name_of(key: str, measure: str) -> str:
    """A step's name."""
    return f"{key}-{measure}"
