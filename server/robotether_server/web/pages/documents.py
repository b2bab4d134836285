"""Serves the documents as a site, which the image holds (images/server/Dockerfile, mkdocs.yml).

Public, and the same for everybody. Must never serve a file of another folder.
"""

from http import HTTPStatus
from pathlib import Path

from flask import Blueprint, redirect, send_from_directory
from werkzeug.security import safe_join
from werkzeug.wrappers import Response as AnyResponse

from robotether_server.problems import HttpError

blueprint = Blueprint("documents", __name__)

SITE = Path(__file__).resolve().parents[1] / "site"
CACHE_S = 300


@blueprint.get("/docs/", defaults={"name": ""})
@blueprint.get("/docs/<path:name>")
def document(name: str) -> AnyResponse:
    """Send a page or what it loads, with the policy that lets its own scripts run."""
    if not SITE.is_dir():
        raise HttpError(
            HTTPStatus.NOT_FOUND,
            "cannot send the documents: this server was started outside of its image, which holds them",
        )
    index = safe_join(str(SITE), name, "index.html")
    if name and not name.endswith("/") and index is not None and Path(index).is_file():
        return redirect(f"/docs/{name}/")
    page = f"{name}index.html" if not name or name.endswith("/") else name
    response = send_from_directory(SITE, page, conditional=True)
    response.headers["Content-Security-Policy"] = (SITE / "policy").read_text()
    response.cache_control.public = True
    response.cache_control.max_age = CACHE_S
    return response
