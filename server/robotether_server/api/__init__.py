"""The REST API under /api/v1, for pages, programs and robots; a module a resource, all on one blueprint.

docs/protocols.md says what they agree on, and openapi/ every path in full. The handlers read fields and
write objects; what may be done and what it changes is decided in `services`.
"""

from robotether_server.api import (
    audit,
    description,
    drives,
    grants,
    groups,
    join,
    join_tokens,
    robot_keys,
    robots,
    sites,
    ssh_keys,
    tickets,
    tokens,
    users,
)
from robotether_server.api.blueprint import blueprint

# Each puts its paths on the blueprint when it is loaded.
RESOURCES = (
    audit,
    description,
    robots,
    drives,
    grants,
    groups,
    join,
    join_tokens,
    users,
    robot_keys,
    robot_keys,
    robots,
    sites,
    ssh_keys,
    tickets,
    tokens,
    users,
)

__all__ = ["RESOURCES", "blueprint"]
