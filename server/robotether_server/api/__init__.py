"""The REST API under /api/v1, for pages, programs and robots; a module a resource, all on one blueprint.

`description` describes every path by its handlers' types (`operations`). `services` decides what may be done, and
does it. docs/reference/protocols.md has what no type says.
"""

# Each puts its paths on the blueprint when it is loaded.
from robotether_server.api import (  # noqa: F401
    audit,
    description,
    drives,
    grants,
    health,
    join,
    metrics,
    recordings,
    requests,
    robots,
    routes,
    ssh_keys,
    tickets,
    tokens,
    users,
)
from robotether_server.api.operations import blueprint

__all__ = ["blueprint"]
