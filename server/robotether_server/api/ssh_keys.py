"""/api/v1/me/ssh-keys and /api/v1/ssh-config: a user's access to the shells of robots."""

from flask import Response, request
from msgspec import Struct

from robotether_server.api.auth import Caller
from robotether_server.api.context import context
from robotether_server.api.operations import Created, operation
from robotether_server.db import users
from robotether_server.db.users import SshKey
from robotether_server.install_line import site_of
from robotether_server.schemas import Label, PublicKeyLine
from robotether_server.services import ssh_keys


class NewSshKey(Struct, forbid_unknown_fields=True):
    """A new key."""

    name: Label
    public_key: PublicKeyLine


class SshKeyList(Struct):
    """Keys, by name."""

    ssh_keys: list[SshKey]


@operation("GET", "/me/ssh-keys", "user")
def list_ssh_keys(caller: Caller) -> SshKeyList:
    """List the user's SSH keys, for shells on robots."""
    return SshKeyList(users.list_ssh_keys(caller.tx, caller.user))


@operation("POST", "/me/ssh-keys", "user", problems=(409,))
def add_ssh_key(caller: Caller, body: NewSshKey) -> Created[SshKey]:
    """Add an SSH key."""
    added = ssh_keys.add(caller.tx, caller.source, caller.user, body.name, body.public_key)
    return added, 201


@operation("DELETE", "/me/ssh-keys/<int:key_id>", "user")
def delete_ssh_key(caller: Caller, key_id: int) -> None:
    """Delete an SSH key, and end the connections that it opened."""
    ssh_keys.delete(caller.tx, caller.source, caller.user, key_id)


@operation("GET", "/ssh-config", "user", texts=("text/plain",))
def ssh_config(caller: Caller) -> Response:
    """Get entries for ~/.ssh/config: a Host for each robot whose shell the user may reach."""
    entries = ssh_keys.shell_entries(caller.tx, caller.user)
    host = site_of(context().site_certificates.settings, request.host).host
    text = ssh_keys.render_config(entries, host, context().join.ssh_ports[0])
    return Response(text, content_type="text/plain; charset=utf-8")
