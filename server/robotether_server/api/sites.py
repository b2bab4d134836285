"""/api/v1/sites: sites of robots, so that a grant can be for all robots of one; for admins.

A robot is put at a site by PATCH /api/v1/robots/NAME.
"""

from msgspec import Struct

from robotether_server.api.auth import Caller
from robotether_server.api.operations import Created, operation
from robotether_server.db import grants
from robotether_server.db.grants import Site
from robotether_server.field_types import NewPlainName
from robotether_server.services import grants as grant_service


class NewSite(Struct, forbid_unknown_fields=True):
    """A site to be added."""

    name: NewPlainName


class SiteList(Struct):
    """Sites, by name."""

    sites: list[Site]


@operation("GET", "/sites", "admin")
def list_sites(caller: Caller) -> SiteList:
    """Sites of robots."""
    return SiteList(grants.list_sites(caller.tx))


@operation("POST", "/sites", "admin", problems=(409,))
def add_site(caller: Caller, body: NewSite) -> Created[Site]:
    """Add a site."""
    return grant_service.add_site(caller.tx, caller.source, body.name), 201


@operation("GET", "/sites/<site>", "admin")
def show_site(caller: Caller, site: str) -> Site:
    """One site."""
    return grants.get_site(caller.tx, site)


@operation("DELETE", "/sites/<site>", "admin")
def remove_site(caller: Caller, site: str) -> None:
    """Remove the site with its grants; its robots are at no site then."""
    grant_service.remove_site(caller.tx, caller.source, site)
