"""Serves the API's description: GET /api/v1/openapi.json, OpenAPI 3.1.

The folder openapi/ holds it in parts that a person can read, a file for what belongs together; they are
joined when somebody asks first.
"""

import json
from functools import cache
from pathlib import Path
from typing import Any

from flask import Response

from robotether_server import __version__
from robotether_server.api.blueprint import blueprint

FOLDER = Path(__file__).parent / "openapi"


@blueprint.get("/openapi.json")
def openapi() -> Response:
    """Describe this API."""
    return Response(_text(), content_type="application/json")


@cache
def _text() -> str:
    return json.dumps(document())


def document() -> dict[str, Any]:
    """Return the whole description."""
    files = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(FOLDER.glob("*.json"))]
    return joined([*files, {"info": {"version": __version__}}])


def joined(files: list[dict[str, Any]]) -> dict[str, Any]:
    """Return one object of several, whose objects are joined likewise; raise ValueError if two say the same thing."""
    whole: dict[str, Any] = {}
    for file in files:
        _add(whole, file, "")
    return whole


def _add(whole: dict[str, Any], part: dict[str, Any], place: str) -> None:
    for name, value in part.items():
        if name not in whole:
            whole[name] = value
        elif isinstance(value, dict) and isinstance(whole[name], dict):
            _add(whole[name], value, f"{place}/{name}")
        else:
            raise ValueError(f"cannot join the description: {place}/{name} is in two files")
