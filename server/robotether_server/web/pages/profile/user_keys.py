"""/profile/ssh-keys: the SSH keys with which one reaches the shells of one's robots."""

from flask import Blueprint, request
from werkzeug.wrappers import Response as AnyResponse

from robotether_server.api.context import context
from robotether_server.db.user_keys import SshKey
from robotether_server.problems import Problem, RecordMissing
from robotether_server.services import ssh_keys
from robotether_server.services.names import MAX_NAME_LENGTH
from robotether_server.ssh_keys import MAX_LINE_LENGTH
from robotether_server.web import confirmation, current_user, forms
from robotether_server.web.confirmation import METHODS, ConfirmedAction
from robotether_server.web.pages.profile.overview import PAGE, render

blueprint = Blueprint("user_keys", __name__, url_prefix="/ssh-keys")


@blueprint.route("", methods=METHODS)
def add() -> AnyResponse | str | tuple[str, int]:
    """Add a key."""
    if request.method == "GET":
        return render()
    try:
        name = forms.optional_text("name", "Name", MAX_NAME_LENGTH)
        line = forms.text("public_key", "Public key", MAX_LINE_LENGTH)
        with context().database.transaction() as tx:
            key = ssh_keys.add(tx, current_user.source(), current_user.get(), name, line)
    except Problem as problem:
        return render(problem, "ssh-keys"), problem.status
    return confirmation.go_on(f"{PAGE}#ssh-keys", f"SSH key {key.name} is added.")


@blueprint.route("/<int:key_id>/delete", methods=METHODS)
def delete(key_id: int) -> AnyResponse:
    """Delete a key."""
    key = _get(key_id)
    action = ConfirmedAction(
        title=f"Delete SSH key {key.name}?",
        effects=(
            f"The key {key.fingerprint} opens no shell any more; connections through it are cut within 2 seconds.",
        ),
        undo="Add the key again.",
        button="Delete",
        done=f"SSH key {key.name} is deleted.",
        back=f"{PAGE}#ssh-keys",
    )
    user = current_user.get()
    return confirmation.run(action, lambda tx, source: ssh_keys.delete(tx, source, user, key_id))


def _get(key_id: int) -> SshKey:
    with context().database.transaction() as tx:
        for key in ssh_keys.list_of(tx, current_user.get()):
            if key.id == key_id:
                return key
    raise RecordMissing("cannot find that SSH key: it was deleted already, or is not yours")
