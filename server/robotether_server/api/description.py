"""Serves the API's description: GET /api/v1/openapi.json, OpenAPI 3.1.

What the operations take and answer is described by their own types (`operations`, `field_types`). The folder openapi/
holds by hand what is not made of them: a file for what belongs together.
"""

import inspect
import json
import re
from collections.abc import Iterator, Mapping
from functools import cache
from http import HTTPStatus
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import msgspec
from flask import Response
from msgspec import Meta

from robotether_server import __version__
from robotether_server.api.blueprint import blueprint
from robotether_server.api.operations import OPERATIONS, Operation, Who
from robotether_server.field_types import PlainName, RobotName, UserName

FOLDER = Path(__file__).parent / "openapi"
REF = "#/components/{kind}/{name}"
Id = Annotated[int, Meta(ge=1)]
# What stands in paths.
PATH_TYPES: dict[str, Any] = {
    "robot": RobotName,
    "user": UserName,
    "group": PlainName,
    "site": PlainName,
    "grant_id": Annotated[int, Meta(ge=1, le=2**32 - 1)],
    "token_id": Id,
    "key_id": Id,
    "drive_id": Id,
}
Object = dict[str, Any]
# The responses of base.json that tell of problems.
PROBLEMS = {
    HTTPStatus.UNAUTHORIZED: "Unauthorized",
    HTTPStatus.FORBIDDEN: "Forbidden",
    HTTPStatus.NOT_FOUND: "NotFound",
    HTTPStatus.CONFLICT: "Conflict",
    HTTPStatus.REQUEST_ENTITY_TOO_LARGE: "TooLarge",
    HTTPStatus.UNSUPPORTED_MEDIA_TYPE: "NotJson",
    HTTPStatus.UNPROCESSABLE_ENTITY: "Invalid",
    HTTPStatus.TOO_MANY_REQUESTS: "TooMany",
    HTTPStatus.SERVICE_UNAVAILABLE: "Unavailable",
}
# Where it is not an API token or a login.
SECURITY: dict[Who, list[Object]] = {
    "anybody": [],
    "enroller": [{"token": []}, {"join_token": []}, {"login": []}],
}


@blueprint.get("/openapi.json")
def openapi() -> Response:
    """Describe this API."""
    return Response(_text(), content_type="application/json")


@cache
def _text() -> str:
    return json.dumps(document())


def document() -> Object:
    """Return the whole description."""
    files = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(FOLDER.glob("*.json"))]
    return joined([*files, _of_operations(OPERATIONS), {"info": {"version": __version__}}])


def _of_operations(operations: list[Operation]) -> Object:
    types = {id(one): one for operation in operations for one in _types(operation)}
    types |= {id(one): one for one in PATH_TYPES.values()}
    found, components = msgspec.json.schema_components(
        types.values(), ref_template=REF.format(kind="schemas", name="{name}")
    )
    schemas = dict(zip(types, found, strict=True))
    paths: Object = {}
    for one in operations:
        path = "/api/v1" + re.sub(r"<(?:\w+:)?(\w+)>", r"{\1}", one.path)
        item = paths.setdefault(path, {})
        item[one.method.lower()] = _operation(one, schemas)
        if one.names:
            item["parameters"] = [_ref("parameters", name) for name in one.names]
    parameters = {
        name: {"name": name, "in": "path", "required": True, "schema": schemas[id(kind)]}
        for name, kind in PATH_TYPES.items()
    }
    return {"paths": paths, "components": {"schemas": components, "parameters": parameters}}


def _types(one: Operation) -> Iterator[Any]:
    yield from (kind for kind in (one.body, *one.answers.values()) if kind is not None)
    if one.query is not None:
        yield from _members(one.query).values()


@cache
def _members(query: Any) -> Mapping[str, Any]:
    """Return the members' types, the same object each time: they are known by their identity."""
    return get_type_hints(query, include_extras=True)


def _operation(one: Operation, schemas: dict[int, Object]) -> Object:
    summary, _, description = (inspect.getdoc(one.handler) or "").partition("\n\n")
    first, *others = one.handler.__name__.split("_")
    found: Object = {
        "operationId": first + "".join(map(str.capitalize, others)),
        "summary": summary.rstrip("."),
        "responses": dict(_responses(one, schemas)),
    }
    if description:
        found["description"] = " ".join(description.split())
    if one.who in SECURITY:
        found["security"] = SECURITY[one.who]
    if one.tag:
        found["tags"] = [one.tag]
    if one.query is not None:
        found["parameters"] = list(_query_parameters(one.query, schemas))
    if one.body is not None:
        content = {"application/json": {"schema": schemas[id(one.body)]}}
        found["requestBody"] = {"required": True, "content": content}
    return found


def _query_parameters(query: Any, schemas: dict[int, Object]) -> Iterator[Object]:
    for name, hint in _members(query).items():
        schema = schemas[id(hint)]
        words = {"description": schema["description"]} if "description" in schema else {}
        yield {"name": name, "in": "query", **words, "schema": schema}


def _responses(one: Operation, schemas: dict[int, Object]) -> Iterator[tuple[str, Object]]:
    for status, kind in one.answers.items():
        content = {name: {"schema": {"type": "string"}} for name in one.texts}
        if kind is not None:
            content["application/json"] = {"schema": schemas[id(kind)]}
        description = HTTPStatus(status).phrase
        yield (
            str(int(status)),
            {"description": description, **({"content": content} if content else {})},
        )
    for status in sorted(_problems(one)):
        yield str(int(status)), _ref("responses", PROBLEMS[HTTPStatus(status)])


def _problems(one: Operation) -> set[int]:
    """Return the statuses of what can go wrong."""
    found = {*one.problems, HTTPStatus.UNAUTHORIZED, HTTPStatus.SERVICE_UNAVAILABLE}
    if one.who == "admin" or one.method != "GET":
        found.add(HTTPStatus.FORBIDDEN)
    if one.names:
        found.add(HTTPStatus.NOT_FOUND)
    if one.body is not None:
        found |= {HTTPStatus.REQUEST_ENTITY_TOO_LARGE, HTTPStatus.UNSUPPORTED_MEDIA_TYPE}
    if one.body is not None or one.query is not None:
        found.add(HTTPStatus.UNPROCESSABLE_ENTITY)
    return found


def _ref(kind: str, name: str) -> Object:
    return {"$ref": REF.format(kind=kind, name=name)}


def joined(files: list[Object]) -> Object:
    """Return one object of several, whose objects are joined likewise; raise ValueError if two say the same thing."""
    whole: Object = {}
    for file in files:
        _add(whole, file, "")
    return whole


def _add(whole: Object, part: Object, place: str) -> None:
    for name, value in part.items():
        if name not in whole:
            whole[name] = value
        elif isinstance(value, dict) and isinstance(whole[name], dict):
            _add(whole[name], value, f"{place}/{name}")
        else:
            raise ValueError(f"cannot join the description: {place}/{name} is in two files")
