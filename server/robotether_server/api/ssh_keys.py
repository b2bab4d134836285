"""/api/v1/me/ssh-keys and /api/v1/ssh-config: a user's access to the shells of robots."""

from dataclasses import asdict
from http import HTTPStatus

from flask import Response, jsonify, request

from robotether_server.api import auth, fields
from robotether_server.api.blueprint import blueprint
from robotether_server.api.context import context
from robotether_server.api.objects import plain
from robotether_server.field_types import MAX_NAME_LENGTH
from robotether_server.install_line import site_of
from robotether_server.services import ssh_config
from robotether_server.services import ssh_keys as ssh_key_service
from robotether_server.ssh_keys import MAX_LINE_LENGTH

MEMBERS = ("name", "public_key")


@blueprint.get("/me/ssh-keys")
def list_ssh_keys() -> Response:
    """List the user's keys."""
    with auth.any_user() as caller:
        found = ssh_key_service.list_of(caller.tx, caller.user)
    return jsonify({"ssh_keys": [plain(asdict(one)) for one in found]})


@blueprint.post("/me/ssh-keys")
def add_ssh_key() -> tuple[Response, int]:
    """Add a key of the user's."""
    with auth.any_user() as caller:
        body = fields.json_object(request, MEMBERS)
        name = fields.text(body, "name", MAX_NAME_LENGTH)
        line = fields.text(body, "public_key", MAX_LINE_LENGTH)
        added = ssh_key_service.add(caller.tx, caller.source, caller.user, name, line)
    return jsonify(plain(asdict(added))), HTTPStatus.CREATED


@blueprint.delete("/me/ssh-keys/<int:key_id>")
def delete_ssh_key(key_id: int) -> tuple[str, int]:
    """Delete a key of the user's; another user's looks like one that does not exist."""
    with auth.any_user() as caller:
        ssh_key_service.delete(caller.tx, caller.source, caller.user, key_id)
    return "", HTTPStatus.NO_CONTENT


@blueprint.get("/ssh-config")
def show_ssh_config() -> Response:
    """Write an entry of ~/.ssh/config for each robot whose shell the user may reach."""
    with auth.any_user() as caller:
        entries = ssh_config.entries(caller.tx, caller.user)
    host = site_of(context().site_certificates.settings, request.host).host
    text = ssh_config.render(entries, host, context().join.ssh_ports[0])
    return Response(text, content_type="text/plain; charset=utf-8")
