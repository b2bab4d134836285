"""What the images under test are called, as compose.yaml does with the tag that TAG gives; and their builds."""

from __future__ import annotations

import os
from pathlib import Path

from commands import output_of_command
from robotether_server import __version__

BUILD = Path(__file__).resolve().parents[3] / "tools" / "build"
# The make targets build first, and say so.
ARE_BUILT = "IMAGES_ARE_BUILT" in os.environ
BUILT_WITHIN_S = 1800


def image(name: str) -> str:
    return f"local.invalid/robotether/{name}:{os.environ.get('TAG') or __version__}"


def ensure_built(*names: str) -> None:
    """Build images from this checkout, unless a make target has built all that a site runs."""
    if not ARE_BUILT:
        output_of_command(BUILD, *names, limit_s=BUILT_WITHIN_S)
