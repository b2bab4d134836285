"""Puts a handler on its path, and keeps what it takes and answers for the description of the API.

A handler's types describe its request and its answer: `body` and `query` are Structs (`schemas` reads them), and its
return value is sent as JSON: a Struct, a record, `Created[...]`, None, or a `Response` of its own. Its docstring is the
operation's `summary` and `description`. The caller is identified first. A request is one transaction: a failure undoes
all of it, and after a deadlock it is done again.
"""

import datetime as dt
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from http import HTTPStatus
from inspect import getdoc
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import msgspec
from flask import Blueprint, Response, jsonify, request

from robotether_server import schemas
from robotether_server.api import auth
from robotether_server.api.auth import Who
from robotether_server.api.context import context
from robotether_server.contract.control import RobotQuery
from robotether_server.db import Transaction
from robotether_server.problems import (
    FieldInvalidError,
    HttpError,
    RecordMissingError,
    RobotUnknownError,
    StoreUnavailableError,
)
from robotether_server.times import rfc3339

Method = Literal["GET", "POST", "PUT", "PATCH", "DELETE"]
Handler = Callable[..., object]
H = TypeVar("H", bound=Handler)
T = TypeVar("T")
# What a handler returns whose status is not 200; with several statuses, as tuple[T, Literal[200, 201]].
Created = tuple[T, Literal[201]]


@dataclass(frozen=True, kw_only=True)
class ApiOperation:
    """One operation of the API: a method of a path.

    `texts`: content types of plain answers. `events`: what each server-sent event carries, of a stream of them.
    `problems`: statuses that `who`, `path`, `body` and `query` do not imply.
    """

    method: Method
    path: str
    name: str
    summary: str
    details: str = ""
    who: Who
    tag: str = ""
    body: Any = None
    is_body_required: bool = True
    query: Any = None
    answers: Mapping[int, Any]
    texts: tuple[str, ...] = ()
    events: Mapping[str, Any] = field(default_factory=dict)
    problems: tuple[int, ...] = ()

    @property
    def names(self) -> list[str]:
        """The names in the path."""
        return re.findall(r"<(?:\w+:)?(\w+)>", self.path)

    @property
    def parameters(self) -> Any:
        """What the query may have; that of a request of a robot may name its MAC, if the body does not."""
        of_robot = "robot" in self.names and self.who != "enroller"
        return self.query or (RobotQuery if of_robot else None)


blueprint = Blueprint("api", __name__, url_prefix="/api/v1")
OPERATIONS: list[ApiOperation] = []


def operation(
    method: Method,
    path: str,
    who: Who,
    *,
    name: str = "",
    tag: str = "",
    any_type: bool = False,
    texts: tuple[str, ...] = (),
    statuses: tuple[int, ...] = (HTTPStatus.OK,),
    problems: tuple[int, ...] = (),
    without_database: Handler | None = None,
    renews_login: bool = True,
) -> Callable[[H], H]:
    """Register a handler for this method of this path, under /api/v1.

    It gets the `caller`, unless `who` is anybody, and the names in the path. `name`: the operation's, if it is not the
    handler's. `any_type`: the body may have any Content-Type, such as that of `curl -d`. `statuses`: those of a
    `Response`. `without_database` answers in the handler's place while the database is away; it gets no `caller`, and
    must find out who asks by itself. Without `renews_login` a login does not count as used: pages ask by themselves.
    """

    def put(handler: H) -> H:
        types = get_type_hints(handler, include_extras=True)
        summary, _, details = (getdoc(handler) or "").partition("\n\n")
        first, *others = handler.__name__.split("_")
        api_operation = ApiOperation(
            method=method,
            path=path,
            name=name or first + "".join(map(str.capitalize, others)),
            summary=summary.rstrip("."),
            details=" ".join(details.split()),
            who=who,
            tag=tag or ("admin" if who in auth.OF_ADMINS else ""),
            body=types.get("body"),
            query=types.get("query"),
            answers=dict(_answers(types["return"])) or dict.fromkeys(statuses),
            texts=texts,
            problems=problems,
        )
        OPERATIONS.append(api_operation)
        arguments = partial(_arguments, api_operation, any_type=any_type)
        view = _view(handler, who, arguments, without_database, renews_login=renews_login)
        blueprint.add_url_rule(path, handler.__name__, view, methods=[method])
        return handler

    return put


def _view(
    handler: Handler,
    who: Who,
    arguments: Callable[[], Mapping[str, object]],
    without_database: Handler | None,
    *,
    renews_login: bool,
) -> Callable[..., Response]:
    """Make what Flask calls with the names in the path; `arguments` reads the request."""
    briefly = without_database is not None
    # Pages get tickets by themselves, when they reconnect; what a person does on them is a request of its own.
    renew = renews_login and not briefly

    def answer(handle: Handler, **names: object) -> Response:
        return respond(handle(**names, **arguments()))

    def answer_caller(tx: Transaction, **names: Any) -> Response:
        caller = auth.admit(tx, who, names.get("robot", ""), renew=renew)
        return answer(handler, caller=caller, **names)

    def view(**names: Any) -> Response:
        try:
            if who == "anybody":
                return answer(handler, **names)
            return context().database.run(partial(answer_caller, **names), briefly=briefly)
        except StoreUnavailableError:
            if without_database is None:
                raise
        return answer(without_database, **names)

    return view


def _answers(returned: Any) -> Iterator[tuple[int, Any]]:
    """Yield each status with the type of its answer; None: no content."""
    for hint in get_args(returned) if isinstance(returned, UnionType) else (returned,):
        if get_origin(hint) is tuple:
            kind, statuses = get_args(hint)
            yield from ((status, kind) for status in get_args(statuses))
        elif hint is NoneType:
            yield HTTPStatus.NO_CONTENT, None
        elif hint is not Response:
            yield HTTPStatus.OK, hint


@blueprint.url_value_preprocessor
def check_names(_endpoint: str | None, values: dict[str, Any] | None) -> None:
    """Refuse names that nobody can have: the database would read `sim1 ` as sim1."""
    for kind in ("robot", "user", "group", "site"):
        name = (values or {}).get(kind, "")
        if name != name.strip():
            problem = RobotUnknownError if kind == "robot" else RecordMissingError
            raise problem(f"cannot find {kind} {name!r}: a name has no spaces")


def _arguments(api_operation: ApiOperation, *, any_type: bool) -> dict[str, object]:
    arguments: dict[str, object] = {}
    if api_operation.body is not None:
        arguments["body"] = schemas.read_body(_body(any_type=any_type), api_operation.body)
    kind, query = api_operation.parameters, request.args
    if kind is None and query:
        name = next(iter(query))[:40]
        raise FieldInvalidError(f"cannot use {name!r}: this request takes nothing in its query")
    parameters = None if kind is None else schemas.read_query(query.items(multi=True), kind)
    return arguments if api_operation.query is None else {**arguments, "query": parameters}


def _body(*, any_type: bool) -> dict[str, object]:
    if not any_type and not request.is_json:
        raise HttpError(
            HTTPStatus.UNSUPPORTED_MEDIA_TYPE,
            "cannot read the body: send one JSON object, with Content-Type: application/json",
        )
    try:
        body = request.get_json(force=True, silent=True)
    except RecursionError:
        body = None
    if not isinstance(body, dict):
        raise FieldInvalidError("cannot read the body: it must be one JSON object")
    return body


def respond(result: object) -> Response:
    """Return the response for a handler's return value."""
    if isinstance(result, Response):
        return result
    if result is None:
        return Response(status=HTTPStatus.NO_CONTENT)
    value, status = result if isinstance(result, tuple) else (result, HTTPStatus.OK)
    response = jsonify(plain(value))
    response.status_code = status
    return response


def plain(value: object) -> Any:
    """Return records and Structs as JSON has them, times as texts."""
    return _plain(msgspec.to_builtins(value, builtin_types=(dt.datetime,)))


def _plain(value: object) -> Any:
    if isinstance(value, dt.datetime):
        return rfc3339(value)
    if isinstance(value, dict):
        return {name: _plain(member) for name, member in value.items()}
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return value
