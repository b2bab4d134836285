"""What the images under test are called: as compose.yaml calls them, with the tag that TAG gives."""

from __future__ import annotations

import os

from robotether_server import __version__


def image(name: str) -> str:
    """The name of one of the images, such as `server`."""
    return f"robotether/{name}:{os.environ.get('TAG') or __version__}"
