"""The REST API under /api/v1, for pages, programs and robots; a module a resource, all on one blueprint.

docs/protocols.md says what they agree on, and `description` every path in full. A handler says by its types what it
takes and answers (`operations`); what may be done and what it changes is decided in `services`.
"""

# Each puts its paths on the blueprint when it is loaded.
from robotether_server.api import (  # noqa: F401
    audit,
    description,
    drives,
    grants,
    join,
    robots,
    ssh_keys,
    tickets,
    tokens,
    users,
)
from robotether_server.api.operations import blueprint

__all__ = ["blueprint"]
