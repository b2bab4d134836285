"""/api/v1/pending and /api/v1/rejected-keys: keys that wait for an admin, and those that one turned away."""

from dataclasses import asdict
from http import HTTPStatus

from flask import Response, jsonify

from robotether_server.api import callers
from robotether_server.api.blueprint import blueprint
from robotether_server.api.objects import plain
from robotether_server.services import pending


@blueprint.get("/pending")
def list_pending() -> Response:
    """List the keys that wait, the oldest first."""
    with callers.admin() as caller:
        waiting = pending.waiting(caller.tx)
    return jsonify({"pending": [plain(asdict(one)) for one in waiting]})


@blueprint.get("/rejected-keys")
def list_rejected_keys() -> Response:
    """List the keys that were turned away, the newest first."""
    with callers.admin() as caller:
        rejected = pending.rejected(caller.tx)
    return jsonify({"rejected_keys": [plain(asdict(one)) for one in rejected]})


@blueprint.delete("/rejected-keys/<int:key_id>")
def forgive_key(key_id: int) -> tuple[str, int]:
    """Let a key ask again."""
    with callers.admin() as caller:
        pending.forgive(caller.tx, caller.source, key_id)
    return "", HTTPStatus.NO_CONTENT
