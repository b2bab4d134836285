"""The battery drains, and charges in the dock."""

import pytest
from sim_robot.battery import CHARGING, DISCHARGING, FULL, Battery
from sim_robot.messages import MessageTypes


def test_driving_drains_more_than_standing() -> None:
    """Both take from it, driving the more."""
    standing, driving = Battery(), Battery()
    standing.step(60.0, driving=False)
    driving.step(60.0, driving=True)
    assert driving.level < standing.level < Battery().level


def test_dock_charges_until_full() -> None:
    """In the dock it fills up and says so."""
    battery = Battery(level=0.9, charging=True)
    battery.step(5.0, driving=False)
    assert battery.level > 0.9
    assert battery.status == CHARGING
    battery.step(3600.0, driving=False)
    assert (battery.level, battery.status) == (1.0, FULL)


def test_who_drives_has_left_the_dock() -> None:
    """Driving ends the charging."""
    battery = Battery(charging=True)
    battery.step(1.0, driving=True)
    assert battery.status == DISCHARGING


def test_never_below_empty() -> None:
    """An empty battery stays at nothing."""
    battery = Battery(level=0.001)
    battery.step(1e6, driving=True)
    assert battery.level == 0.0


def test_message_fits_its_type() -> None:
    """A whole BatteryState, with the part of 1 that rosbridge's clients expect."""
    types = MessageTypes(2)
    values = Battery(level=0.5).values(types.header("", 0, 1))
    # Not a number is not equal to itself, so it is compared as text.
    assert str(types.conform("sensor_msgs/BatteryState", values, 0)) == str(values)
    assert values["percentage"] == pytest.approx(0.5)
