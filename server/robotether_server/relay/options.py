"""What a relay is started with beside its settings; `main` leaves all of it as it is, and tests do not."""

from __future__ import annotations

from dataclasses import dataclass, field

from robotether_server.relay.cells.drain import DrainRules
from robotether_server.relay.cells.rebalancing import BalanceRules
from robotether_server.relay.http.timing import DRIVER_LIMITS, LivenessLimits
from robotether_server.relay.robots.robot_link import HeartbeatTimes


@dataclass(frozen=True)
class Listen:
    """Where the relay listens; tests give port 0."""

    host: str = "0.0.0.0"  # noqa: S104  # compose publishes none of these ports
    http_port: int = 8080
    session_port: int = 8091
    peer_port: int = 8092
    inside_port: int = 9100


@dataclass(frozen=True)
class Timing(HeartbeatTimes):
    """Times that tests shorten."""

    limits: LivenessLimits = field(default_factory=LivenessLimits)
    driver_limits: LivenessLimits = DRIVER_LIMITS
    poll_every_s: float = 1.0
    drives_every_s: float = 10.0
    drain: DrainRules = field(default_factory=DrainRules)
    balance: BalanceRules = field(default_factory=BalanceRules)
