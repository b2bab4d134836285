"""The simulated robot's battery: it drains with time and more with driving, and charges in the dock.

Used by devices.py, once a second.
"""

import math
from dataclasses import dataclass

from sim_robot.messages import Values

FULL_V, EMPTY_V = 29.4, 22.0
DRAIN_STANDING, DRAIN_DRIVING, CHARGE = 1 / 28_800, 1 / 7_200, 1 / 200  # of all it holds, a second
CHARGING, DISCHARGING, FULL = 1, 2, 4  # POWER_SUPPLY_STATUS_*
HEALTH_GOOD, TECHNOLOGY_LION = 1, 2


@dataclass
class BatteryModel:
    """How full it is, from 0 to 1, and whether it charges."""

    level: float = 0.81
    charging: bool = False

    def step(self, seconds: float, *, driving: bool) -> None:
        """Let time pass; a robot that drives has left its dock."""
        self.charging = self.charging and not driving
        drain = DRAIN_DRIVING if driving else DRAIN_STANDING
        change = CHARGE if self.charging else -drain
        self.level = min(max(self.level + change * seconds, 0.0), 1.0)

    @property
    def status(self) -> int:
        """The power supply's status."""
        if not self.charging:
            return DISCHARGING
        return FULL if self.level >= 1.0 else CHARGING

    def values(self, header: Values) -> Values:
        """Write a sensor_msgs/BatteryState; what is not measured is not a number."""
        return {
            "header": header,
            "voltage": round(EMPTY_V + (FULL_V - EMPTY_V) * self.level, 2),
            "temperature": math.nan,
            "current": math.nan,
            "charge": math.nan,
            "capacity": math.nan,
            "design_capacity": math.nan,
            "percentage": round(self.level, 4),
            "power_supply_status": self.status,
            "power_supply_health": HEALTH_GOOD,
            "power_supply_technology": TECHNOLOGY_LION,
            "present": True,
            "cell_voltage": [],
            "cell_temperature": [],
            "location": "base",
            "serial_number": "simulated",
        }
