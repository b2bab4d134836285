"""/api/v1/sites: sites of robots; a grant can be for all robots of a site; for admins.

A robot is put at a site by PATCH /api/v1/robots/NAME.
"""

from msgspec import Struct

from robotether_server.api.auth import Caller
from robotether_server.api.operations import Created, operation
from robotether_server.db import sites
from robotether_server.db.sites import Site
from robotether_server.field_types import NewPlainName
from robotether_server.services import sites as site_service


class NewSite(Struct, forbid_unknown_fields=True):
    """A new site."""

    name: NewPlainName


class SiteList(Struct):
    """Sites, by name."""

    sites: list[Site]


@operation("GET", "/sites", "admin")
def list_sites(caller: Caller) -> SiteList:
    """List sites of robots."""
    return SiteList(sites.list_all(caller.tx))


@operation("POST", "/sites", "admin", problems=(409,))
def add_site(caller: Caller, body: NewSite) -> Created[Site]:
    """Add a site."""
    return site_service.add(caller.tx, caller.source, body.name), 201


@operation("GET", "/sites/<site>", "admin")
def show_site(caller: Caller, site: str) -> Site:
    """Get a site."""
    return sites.get(caller.tx, site)


@operation("DELETE", "/sites/<site>", "admin")
def remove_site(caller: Caller, site: str) -> None:
    """Remove the site with its grants; its robots stay, without a site."""
    site_service.remove(caller.tx, caller.source, site)
