"""/api/v1/metrics: the numbers of the relay of this machine, for an admin's Prometheus."""

from flask import Response

from robotether_server.api.auth import Caller
from robotether_server.api.operations import operation

# Where nginx asks the relay, for answers of web alone.
RELAY_PATH = "/relay-metrics"
TEXT_TYPE = "text/plain"


@operation("GET", "/metrics", "admin", texts=(TEXT_TYPE,), renews_login=False)
def get_metrics(caller: Caller) -> Response:  # an admin, which is all that it says
    """Get the numbers of this machine in Prometheus' text format.

    Those of its relay and of the robots that it has; each machine of a site has its own. An address may ask once a
    second.
    """
    # Prometheus reads no answer without the version.
    response = Response(content_type=f"{TEXT_TYPE}; version=0.0.4; charset=utf-8")
    response.headers["X-Accel-Redirect"] = RELAY_PATH
    return response
