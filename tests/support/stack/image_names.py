"""What the images under test are called, as compose.yaml does with the tag that TAG gives; and their builds."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

from robotether_server import __version__

BUILD = Path(__file__).resolve().parents[3] / "tools" / "build"
# The make targets build first, and say so.
ARE_BUILT = "IMAGES_ARE_BUILT" in os.environ


def image(name: str) -> str:
    """The name of one of the images, such as `server`."""
    return f"local.invalid/robotether/{name}:{os.environ.get('TAG') or __version__}"


def ensure_built(*names: str) -> None:
    """Build images from this checkout, unless a make target has built all that a site runs."""
    if ARE_BUILT:
        return
    done = subprocess.run([BUILD, *names], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-4000:]
