"""Serves the installer: the script, the agent with the hashes of its files, and its Debian packages.

Public, and the same for everybody. The image holds the files (images/server/Dockerfile); the manifest is
written where the wheel is built. Must never serve a file that none of these routes names.
"""

import hashlib
from http import HTTPStatus

from flask import Blueprint, Response, request, send_file

from robotether_server.api.context import context
from robotether_server.problems import HttpError

blueprint = Blueprint("installer", __name__)

SCRIPT = "join.sh"
MANIFEST = "manifest"
TEXT = "text/plain; charset=utf-8"
# Of the packages; the first where none is asked for.
ARCHITECTURES = ("amd64", "arm64")


@blueprint.get("/join.sh")
def script() -> Response:
    """Send the installer."""
    return _send(SCRIPT, "text/x-shellscript; charset=utf-8")


@blueprint.get("/agent/manifest")
def manifest() -> Response:
    """List what else is under /agent/, a line a file, as sha256sum prints it."""
    return _send(MANIFEST, TEXT)


@blueprint.get("/agent/<name>")
def agent_file(name: str) -> Response:
    """Send one of the listed files."""
    if name not in listed(_read(MANIFEST).decode()):
        raise HttpError(
            HTTPStatus.NOT_FOUND, f"cannot send {name}: /agent/manifest does not list it"
        )
    kind = TEXT if name.endswith(".txt") else "application/octet-stream"
    return _send(name, kind)


@blueprint.get("/agent.deb")
def package() -> Response:
    """Send the Debian package for `?arch=`."""
    architecture = request.args.get("arch", ARCHITECTURES[0])
    if architecture not in ARCHITECTURES:
        names = " or ".join(ARCHITECTURES)
        why = f"cannot send a package for this arch: it must be {names}"
        raise HttpError(HTTPStatus.NOT_FOUND, why)
    packages = sorted(context().agent_files_dir.glob(f"*_{architecture}.deb"))
    if not packages:
        raise _missing(f"agent.deb for {architecture}")
    # In pieces: it is some 12 MB, and a robot's link may be slow.
    return send_file(
        packages[-1],
        "application/vnd.debian.binary-package",
        download_name=packages[-1].name,
        max_age=0,
    )


def listed(text: str) -> dict[str, str]:
    """Return the SHA-256 of each file of a manifest, by name."""
    pairs = (line.split("  ", 1) for line in text.splitlines())
    return {name: digest for digest, name in pairs}


def _read(name: str) -> bytes:
    try:
        return (context().agent_files_dir / name).read_bytes()
    except FileNotFoundError as error:
        raise _missing(name) from error


def _missing(what: str) -> HttpError:
    return HttpError(
        HTTPStatus.NOT_FOUND,
        f"cannot send {what}: this server was started outside of its image, which holds it",
    )


def _send(name: str, kind: str) -> Response:
    data = _read(name)
    response = Response(data, content_type=kind)
    # Cached, but revalidated each time, so that script, manifest and files match.
    response.cache_control.no_cache = True
    response.set_etag(hashlib.sha256(data).hexdigest())
    response.make_conditional(request)
    return response
