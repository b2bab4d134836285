"""Serves the API's description: GET /api/v1/openapi.json, OpenAPI 3.1.

What the operations take and answer is described by their own types (`operations`, `relayed`, `schemas`); only what
they have in common is here.
"""

import json
import re
from collections.abc import Iterator, Mapping
from functools import cache
from http import HTTPStatus
from inspect import cleandoc
from typing import Annotated, Any, get_type_hints

import msgspec
from flask import Response
from msgspec import Meta
from robotether_common.ros import MAX_NAME_LENGTH

from robotether_server import __version__
from robotether_server.api.auth import OF_ADMINS, Who
from robotether_server.api.operations import OPERATIONS, ApiOperation, operation
from robotether_server.api.relayed import RELAYED
from robotether_server.schemas import PlainName, RobotName, UserName
from robotether_server.settings.robot import GivenSettings

REF = "#/components/{kind}/{name}"
Id = Annotated[int, Meta(ge=1)]
RosPath = Annotated[
    str,
    Meta(
        description="Its full name, with or without the first slash; slashes may be %2F",
        extra_json_schema={"maxLength": MAX_NAME_LENGTH, "examples": ["odom", "arm/move"]},
    ),
]
# Names and ids in paths.
PATH_TYPES: dict[str, Any] = {
    "robot": RobotName,
    "user": UserName,
    "group": PlainName,
    "site": PlainName,
    "grant_id": Annotated[int, Meta(ge=1, le=2**32 - 1)],
    "token_id": Id,
    "key_id": Id,
    "drive_id": Id,
    "request_id": Annotated[int, Meta(ge=1, le=2**32 - 1)],
    "recording_id": Id,
    "route_id": Id,
    "topic": RosPath,
    "service": RosPath,
}
Object = dict[str, Any]
EVENT_STREAM = "text/event-stream"
# Where it is not an API token or a login.
SECURITY: dict[Who, list[Object]] = {
    "anybody": [],
    "enroller": [{"token": []}, {"join_token": []}, {"login": []}],
}
# The problems of each status.
PROBLEMS = {
    400: ("BadRequest", "bad_request: the body is not JSON"),
    401: ("Unauthorized", "login_missing, token_invalid, token_expired or token_used_up"),
    403: (
        "Forbidden",
        "grant_missing: the user's role or grant is not enough; csrf_refused: a change by a login without X-CSRFToken",
    ),
    404: (
        "NotFound",
        "robot_unknown or record_missing: it does not exist, or the user may not see it; "
        "not_found: no such path",
    ),
    409: ("Conflict", "The request contradicts a record: see `code` and `detail`"),
    413: (
        "TooLarge",
        "body_too_large: over 64 KB; with the tag control request_entity_too_large: over 4 KiB",
    ),
    415: ("NotJson", "unsupported_media_type: the body was not sent as application/json"),
    416: ("NoSuchPiece", "requested_range_not_satisfiable: the file is shorter"),
    422: ("Invalid", "field_invalid or record_refused: `detail` names the field"),
    429: (
        "TooMany",
        "A limit is reached: see `code` and `detail`; too_many_requests: that of the caller's address",
    ),
    502: ("RobotSilent", "rosbridge_down or topic_down: the robot's ROS does not answer"),
    503: (
        "Unavailable",
        "store_unavailable, front_unavailable or service_away: try again shortly; robot_offline",
    ),
    504: (
        "Late",
        "guard_silent: the robot did not confirm it and stays stopped; service_timeout: no answer in time",
    ),
}
AUTHENTICATE = {"WWW-Authenticate": {"required": True, "schema": {"const": "Bearer"}}}
BASE: Object = {
    "openapi": "3.1.0",
    "info": {
        "title": "Robotether",
        "version": __version__,
        "license": {"name": "Apache-2.0", "identifier": "Apache-2.0"},
        "description": "Robots, rights and joins. docs/reference/protocols.md describes the WebSockets that a ticket "
        "opens. A body must be sent as application/json, except for tickets, joins and stops. Undescribed members "
        "are refused (a join and a stop of one robot ignore them). "
        "Operations with the tag admin answer 403 to users without that role, whatever they name.",
    },
    "servers": [{"url": "/"}],
    "security": [{"token": []}, {"login": []}],
    "tags": [{"name": "admin", "description": "For admins only"}],
    "components": {
        "securitySchemes": {
            "token": {"type": "http", "scheme": "bearer", "description": "An API token, rt_..."},
            "join_token": {
                "type": "http",
                "scheme": "bearer",
                "description": "A join token, rj_...",
            },
            "login": {
                "type": "apiKey",
                "in": "cookie",
                "name": "__Host-robotether_login",
                "description": "A browser's login; a change also needs the page's token in the header X-CSRFToken",
            },
        },
        "responses": {
            name: {
                "description": description,
                **({"headers": AUTHENTICATE} if status == HTTPStatus.UNAUTHORIZED else {}),
                "content": {
                    "application/problem+json": {"schema": {"$ref": "#/components/schemas/Problem"}}
                },
            }
            for status, (name, description) in PROBLEMS.items()
        },
        "schemas": {
            "Problem": {
                "type": "object",
                "required": ["type", "title", "status", "code", "detail"],
                "properties": {
                    **{name: {"type": "string"} for name in ("type", "title", "code", "detail")},
                    "status": {"type": "integer"},
                },
                "description": "RFC 9457; `code` is stable, `detail` is a sentence for people",
            }
        },
    },
}


@operation("GET", "/openapi.json", "anybody")
def openapi() -> dict[str, Any] | Response:
    """This document."""
    return Response(_text(), content_type="application/json")


@cache
def _text() -> str:
    return json.dumps(document())


def document() -> Object:
    """Return the whole description."""
    operations = [*OPERATIONS, *RELAYED]
    types = {id(hint): hint for operation in operations for hint in _types(operation)}
    types |= {id(hint): hint for hint in (*PATH_TYPES.values(), GivenSettings)}
    type_schemas, components = msgspec.json.schema_components(
        types.values(), ref_template=REF.format(kind="schemas", name="{name}")
    )
    for component in components.values():
        component["description"] = cleandoc(component["description"])
        _without_defaults(component)
    # A cell may leave members out, the stream does not.
    components["RobotObject"]["required"] = sorted(components["RobotObject"]["properties"])
    of_types = dict(zip(types, type_schemas, strict=True))
    paths: Object = {}
    for api_operation in operations:
        path = "/api/v1" + re.sub(r"<(?:\w+:)?(\w+)>", r"{\1}", api_operation.path)
        item = paths.setdefault(path, {})
        item[api_operation.method.lower()] = _operation(api_operation, of_types)
        if api_operation.names:
            item["parameters"] = [_ref("parameters", name) for name in api_operation.names]
    parameters = {
        name: {"name": name, "in": "path", "required": True, "schema": of_types[id(kind)]}
        for name, kind in PATH_TYPES.items()
    }
    base = BASE["components"]
    schemas = base["schemas"] | components
    return BASE | {
        "paths": paths,
        "components": base | {"schemas": schemas, "parameters": parameters},
    }


def _without_defaults(component: Object) -> None:
    # The reference prints the defaults of settings (tools/site/hooks.py); a record has every member.
    for member in component.get("properties", {}).values():
        member.pop("default", None)


def _types(operation: ApiOperation) -> Iterator[Any]:
    yield from (kind for kind in (operation.body, *operation.answers.values()) if kind is not None)
    yield from operation.events.values()
    if (query := operation.parameters) is not None:
        yield from _members(query).values()


@cache
def _members(query: Any) -> Mapping[str, Any]:
    """Return the members' types, the same object each time: they are known by their identity."""
    return get_type_hints(query, include_extras=True)


def _operation(operation: ApiOperation, schemas: dict[int, Object]) -> Object:
    members: Object = {
        "operationId": operation.name,
        "summary": operation.summary,
        "responses": dict(_responses(operation, schemas)),
    }
    if operation.details:
        members["description"] = operation.details
    if operation.who in SECURITY:
        members["security"] = SECURITY[operation.who]
    if operation.tag:
        members["tags"] = [operation.tag]
    if (query := operation.parameters) is not None:
        members["parameters"] = list(_query_parameters(query, schemas))
    if operation.body is not None:
        content = {"application/json": {"schema": schemas[id(operation.body)]}}
        members["requestBody"] = {"required": operation.is_body_required, "content": content}
    return members


def _query_parameters(query: Any, schemas: dict[int, Object]) -> Iterator[Object]:
    for name, hint in _members(query).items():
        schema = schemas[id(hint)]
        words = {"description": schema["description"]} if "description" in schema else {}
        yield {"name": name, "in": "query", **words, "schema": schema}


def _responses(operation: ApiOperation, schemas: dict[int, Object]) -> Iterator[tuple[str, Object]]:
    for status, kind in operation.answers.items():
        content = {name: {"schema": {"type": "string"}} for name in operation.texts}
        if operation.events:
            content[EVENT_STREAM] = {"schema": _stream(operation.events, schemas)}
        if kind is not None:
            content["application/json"] = {"schema": schemas[id(kind)]}
        description = HTTPStatus(status).phrase
        yield (
            str(int(status)),
            {"description": description, **({"content": content} if content else {})},
        )
    for status in sorted(_problems(operation)):
        yield str(int(status)), _ref("responses", PROBLEMS[status][0])


def _stream(events: Mapping[str, Any], schemas: dict[int, Object]) -> Object:
    """Describe a stream of server-sent events: a text, which has these events; the data of each is JSON."""
    kinds = [
        {
            "type": "object",
            "required": ["event", "data"],
            "properties": {"event": {"const": name}, "data": schemas[id(kind)]},
        }
        for name, kind in events.items()
    ]
    items = {"type": "array", "items": {"oneOf": kinds}}
    return {"type": "string", "contentMediaType": EVENT_STREAM, "contentSchema": items}


def _problems(operation: ApiOperation) -> set[int]:
    """Return the statuses of its problems."""
    if operation.who == "anybody" and operation.body is None:
        return {*operation.problems, 422, 429}
    statuses = {*operation.problems, 401, 422, 429, 503}
    if operation.who in OF_ADMINS or operation.method != "GET":
        statuses.add(403)
    if operation.names:
        statuses.add(404)
    if operation.body is not None:
        statuses |= {413, 415}
    return statuses


def _ref(kind: str, name: str) -> Object:
    return {"$ref": REF.format(kind=kind, name=name)}
