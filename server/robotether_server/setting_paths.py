"""A robot's settings by paths such as guard.deadman_ms, as the page's form and the command line name them.

Settings are JSON objects in one another; nothing here knows which there are (robot_settings.py does). Pure:
what is given is never changed.
"""

from collections.abc import Mapping

Settings = dict[str, object]


def get_path(settings: Mapping[str, object], path: str) -> object:
    """Return what stands at a path; None where nothing does."""
    found: object = settings
    for step in path.split("."):
        found = found.get(step) if isinstance(found, Mapping) else None
    return found


def is_in(settings: Mapping[str, object], path: str) -> bool:
    """Tell whether something stands there, be it null."""
    folder, dot, last = path.rpartition(".")
    found = get_path(settings, folder) if dot else settings
    return isinstance(found, Mapping) and last in found


def put_path(settings: Mapping[str, object], path: str, value: object) -> Settings:
    """Return settings in which the value stands there, in place of what stood there or in its way."""
    first, dot, rest = path.partition(".")
    return {**settings, first: put_path(_inner(settings, first), rest, value) if dot else value}


def remove_path(settings: Mapping[str, object], path: str) -> Settings:
    """Return settings in which nothing stands there."""
    first, dot, rest = path.partition(".")
    if not is_in(settings, path):
        return dict(settings)
    if dot:
        return {**settings, first: remove_path(_inner(settings, first), rest)}
    return {name: value for name, value in settings.items() if name != first}


def _inner(settings: Mapping[str, object], name: str) -> Mapping[str, object]:
    found = settings.get(name)
    return found if isinstance(found, Mapping) else {}
