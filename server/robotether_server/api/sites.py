"""/api/v1/sites: sites of robots, so that a grant can be for all robots of one; for admins.

A robot is put at a site by PATCH /api/v1/robots/NAME.
"""

from http import HTTPStatus

from flask import Response, jsonify, request

from robotether_server.api import auth, fields
from robotether_server.api.blueprint import blueprint
from robotether_server.db import sites
from robotether_server.db.sites import Site
from robotether_server.services import sites as site_service
from robotether_server.services.names import MAX_NAME_LENGTH


@blueprint.get("/sites")
def list_sites() -> Response:
    """List the sites with their robots."""
    with auth.admin() as caller:
        found = sites.list_all(caller.tx)
    return jsonify({"sites": [_object(one) for one in found]})


@blueprint.post("/sites")
def add_site() -> tuple[Response, int]:
    """Add a site without robots."""
    with auth.admin() as caller:
        name = fields.text(fields.json_object(request, ("name",)), "name", MAX_NAME_LENGTH)
        added = site_service.add(caller.tx, caller.source, name)
    return jsonify(_object(added)), HTTPStatus.CREATED


@blueprint.get("/sites/<site>")
def show_site(site: str) -> Response:
    """Show one site."""
    with auth.admin() as caller:
        found = sites.get(caller.tx, site)
    return jsonify(_object(found))


@blueprint.delete("/sites/<site>")
def remove_site(site: str) -> tuple[str, int]:
    """Remove the site with its grants; its robots are at no site then."""
    with auth.admin() as caller:
        site_service.remove(caller.tx, caller.source, site)
    return "", HTTPStatus.NO_CONTENT


def _object(site: Site) -> dict[str, object]:
    return {"id": site.id, "name": site.name, "robots": list(site.robots)}
