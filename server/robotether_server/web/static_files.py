"""Says how long browsers keep static files, whose addresses change with their content."""

import functools
import hashlib
from pathlib import Path
from typing import Any

from flask import Flask, Response, request

# Time for which a browser keeps a file of a content: the most that browsers take.
CACHE_S = 365 * 24 * 3600
# Pages of other sites load it by this address. Kept so shortly that an upgrade reaches all pages.
CLIENT = "/static/dist/robotether-client.js"
CLIENT_CACHE_S = 300


def register(app: Flask) -> None:
    """Add `v`, the version of the content, to all addresses of static files, and let browsers keep those."""

    def path_of(filename: str) -> Path:
        return Path(app.static_folder or "") / filename

    @app.url_defaults
    def add_version(endpoint: str, values: dict[str, Any]) -> None:
        # Scripts are not there before they are built.
        if endpoint == "static" and (path := path_of(values["filename"])).exists():
            values["v"] = _version(path)

    @app.after_request
    def let_keep(response: Response) -> Response:
        if request.path == CLIENT:
            response.headers["Cache-Control"] = f"public, max-age={CLIENT_CACHE_S}"
        # A page of another release asks for another content: that answer must not stay under its address.
        elif request.endpoint == "static" and response.status_code in (200, 304):
            path = path_of((request.view_args or {})["filename"])
            if request.args.get("v") == _version(path):
                response.headers["Cache-Control"] = f"public, max-age={CACHE_S}, immutable"
        return response


def _version(path: Path) -> str:
    return _hashed(path, path.stat().st_mtime_ns)


@functools.cache
def _hashed(path: Path, _modified_ns: int) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]
