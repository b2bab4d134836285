"""/api/v1/metrics: the numbers of relay and web of this machine, for an admin's Prometheus.

It may have a token that reads them and does nothing else.
"""

from flask import Response

from robotether_server.api.auth import Caller
from robotether_server.api.context import context
from robotether_server.api.operations import operation

# Where nginx asks the relay, for answers of web alone.
RELAY_PATH = "/relay-metrics"
TEXT_TYPE = "text/plain"
# Prometheus reads no answer without the version.
CONTENT_TYPE = f"{TEXT_TYPE}; version=0.0.4; charset=utf-8"


@operation("GET", "/metrics", "metrics", texts=(TEXT_TYPE,))
def get_metrics(caller: Caller) -> Response:  # an admin, which is all that it says
    """Get the numbers of this machine in Prometheus' text format.

    Those of its relay and of the robots that it has; each machine of a site has its own. An address may ask once a
    second. For admins, also by a token that is for metrics alone.
    """
    response = Response(content_type=CONTENT_TYPE)
    response.headers["X-Accel-Redirect"] = RELAY_PATH
    return response


@operation("GET", "/metrics/web", "metrics", texts=(TEXT_TYPE,))
def get_web_metrics(caller: Caller) -> Response:  # as above
    """Get the numbers of this machine's web in Prometheus' text format: requests, log-ins, the certificate."""
    return Response(context().metrics.render(), content_type=CONTENT_TYPE)
