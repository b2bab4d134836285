"""/api/v1/join: what a robot asks at its first start, and whenever it is not admitted."""

from http import HTTPStatus

from flask import Response, jsonify, request

from robotether_server import macs, ssh_keys
from robotether_server.api import fields
from robotether_server.api.blueprint import blueprint
from robotether_server.api.context import context
from robotether_server.api.objects import ssh_object
from robotether_server.db.robots import Report
from robotether_server.problems import FieldInvalid
from robotether_server.services import joining
from robotether_server.services.enrolment import PresentedKey
from robotether_server.services.joining import Answer, PreviousKey

MAX_HOSTNAME_LENGTH = 253
MAX_VERSION_LENGTH = 32
MAX_TOKEN_LENGTH = 200
MAX_WISHED_NAME_LENGTH = 253
MAX_FINGERPRINT_LENGTH = 64


@blueprint.post("/join")
def join() -> tuple[Response, int]:
    """Let a robot in, or note that it waits."""
    asked = _asked(fields.json_object(request, any_type=True))
    with context().database.transaction() as tx:
        answer = joining.is_in(tx, asked)
    if answer is None:
        with context().database.transaction() as tx:
            answer = joining.join(tx, asked, context().join)
    if answer.code == "active":
        return jsonify(_joined(answer)), HTTPStatus.OK
    return jsonify(_pending(answer)), HTTPStatus.ACCEPTED


def _asked(body: dict[str, object]) -> joining.JoinRequest:
    report = Report(
        hostname=fields.text(body, "hostname", MAX_HOSTNAME_LENGTH),
        agent_version=fields.text(body, "agent_version", MAX_VERSION_LENGTH),
        address=request.remote_addr or "",
    )
    return joining.JoinRequest(
        presented=PresentedKey(
            mac=macs.normalise(fields.text(body, "mac", macs.MAX_TEXT_LENGTH)),
            key=ssh_keys.parse(fields.text(body, "public_key", ssh_keys.MAX_LINE_LENGTH)),
            report=report,
        ),
        token=fields.optional_text(body, "token", MAX_TOKEN_LENGTH),
        name=fields.optional_text(body, "name", MAX_WISHED_NAME_LENGTH),
        mac_present=body.get("mac_present") is None or fields.flag(body, "mac_present"),
        previous=_previous(body),
    )


def _previous(body: dict[str, object]) -> PreviousKey | None:
    if body.get("previous_key") is None:
        return None
    given = fields.mapping(body, "previous_key")
    signature = fields.secret(given, "signature")
    if len(signature) > ssh_keys.MAX_SIGNATURE_LENGTH:
        raise FieldInvalid("cannot use signature: it is longer than one of an ssh-ed25519 key")
    return PreviousKey(fields.text(given, "fingerprint", MAX_FINGERPRINT_LENGTH), signature)


def _joined(answer: Answer) -> dict[str, object]:
    return {"state": "active", "robot": answer.robot, "ssh": ssh_object(context().join)}


def _pending(answer: Answer) -> dict[str, object]:
    return {
        "state": "pending",
        "robot": answer.robot,
        "code": answer.code,
        "detail": answer.detail,
    }
