"""Services are found by name."""

import pytest
from sim_robot.problems import ServiceUnknown
from sim_robot.services import Service, Services


def test_service_is_found() -> None:
    """What was added is there, sorted by name."""
    services = Services()
    for name in ("/b", "/a"):
        services.add(Service(name, "std_srvs/Empty", "/n", (), lambda request: request))
    assert [service.name for service in services.all()] == ["/a", "/b"]
    assert services.get("/a").handler({}) == {}


def test_unknown_service_is_named() -> None:
    """A service that nobody offers is a problem that names it."""
    with pytest.raises(ServiceUnknown, match="/nope"):
        Services().get("/nope")
