"""/api/v1/metrics: the numbers of a machine's relay and web, for an admin's Prometheus.

It may have a token that reads them and does nothing else.
"""

from typing import Annotated

from flask import Response
from msgspec import UNSET, Meta, Struct, UnsetType

from robotether_server.api.auth import Caller
from robotether_server.api.context import context
from robotether_server.api.operations import operation
from robotether_server.schemas import MAX_NAME_LENGTH

# Where nginx asks the relay, for answers of web alone.
RELAY_PATH = "/relay-metrics"
TEXT_TYPE = "text/plain"
# Prometheus reads no answer without the version.
CONTENT_TYPE = f"{TEXT_TYPE}; version=0.0.4; charset=utf-8"
CellName = Annotated[
    str,
    Meta(
        max_length=MAX_NAME_LENGTH,
        pattern="^[a-z0-9-]+$",
        extra={"must": f"1 to {MAX_NAME_LENGTH} of a-z, 0-9 and -"},
    ),
]


class MetricsQuery(Struct, forbid_unknown_fields=True):
    """The machine of the site, by its name as a cell; without it the one that is asked."""

    cell: CellName | UnsetType = UNSET


@operation("GET", "/metrics", "metrics", texts=(TEXT_TYPE,), problems=(404,))
def get_metrics(caller: Caller, query: MetricsQuery) -> Response:  # `caller` is an admin
    """Get the numbers of a machine of the site in Prometheus' text format.

    Those of its relay and of the robots that it has. An address may ask once a second. For admins, also by a token that
    is for metrics alone.
    """
    response = Response(content_type=CONTENT_TYPE)
    response.headers["X-Accel-Redirect"] = (
        f"{RELAY_PATH}?cell={query.cell}" if query.cell else RELAY_PATH
    )
    return response


@operation("GET", "/metrics/web", "metrics", texts=(TEXT_TYPE,))
def get_web_metrics(caller: Caller) -> Response:  # as above
    """Get the numbers of this machine's web in Prometheus' text format: requests, log-ins, the certificate."""
    return Response(context().metrics.render(), content_type=CONTENT_TYPE)
