"""Which robots there are: the entries of OpenSSH's configuration that `robotether ssh-config` printed.

They are known by their `HostKeyAlias robotether-NAME`, so a pattern such as `*` reaches no other host of the person.
"""

import glob
import shlex
from collections.abc import Iterable, Iterator
from fnmatch import fnmatchcase
from pathlib import Path

from robotether_server.cli.fleet.problems import ConfigUnusable, RobotsUnknown

USER_CONFIG = Path("~/.ssh/config")
ALIAS = "robotether-"
MAX_INCLUDE_DEPTH = 16  # OpenSSH's own bound


def choose(config: Path | None, patterns: Iterable[str]) -> list[str]:
    """Return the robots that a pattern names, by name; raise RobotsUnknown for a pattern without any."""
    path = (config or USER_CONFIG).expanduser()
    known = sorted(robots_in(path))
    chosen: set[str] = set()
    for pattern in patterns:
        found = [name for name in known if fnmatchcase(name, pattern)]
        if not found:
            names = ", ".join(known) or "no robot at all"
            raise RobotsUnknown(
                f"cannot find robots for {pattern}: {path} has {names}; bring it up to date with: robotether ssh-config"
            )
        chosen.update(found)
    return sorted(chosen)


def robots_in(path: Path) -> set[str]:
    """Return the names of all robots of a configuration and of what it includes."""
    names: list[str] = []
    robots: set[str] = set()
    for keyword, arguments in directives(path):
        if keyword in ("host", "match"):
            names = [name for name in arguments if keyword == "host" and is_plain(name)]
        elif keyword == "hostkeyalias" and arguments and arguments[0].startswith(ALIAS):
            robots.update(names)
    return robots


def is_plain(name: str) -> bool:
    """Tell whether a `Host` names one host, and is no pattern."""
    return not set(name) & set("*?!")


def directives(path: Path, depth: int = 0) -> Iterator[tuple[str, list[str]]]:
    """Yield each keyword in small letters with its arguments; included files stand where they are included."""
    if depth > MAX_INCLUDE_DEPTH:
        raise ConfigUnusable(f"cannot read {path}: it is included over {MAX_INCLUDE_DEPTH} deep")
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigUnusable(
            f"cannot read {path}: {error}; write it with: robotether ssh-config, or name another with --ssh-config"
        ) from error
    for line in text.splitlines():
        keyword, arguments = words(line)
        if keyword == "include":
            for included in (part for pattern in arguments for part in matches(pattern)):
                yield from directives(included, depth + 1)
        elif keyword:
            yield keyword, arguments


def words(line: str) -> tuple[str, list[str]]:
    """Split `Keyword argument "another one"` or `Keyword=argument`; a line that says nothing gives an empty keyword."""
    try:
        parts = shlex.split(line, comments=True)
    except ValueError:
        return "", []
    if not parts:
        return "", []
    keyword, equals, rest = parts[0].partition("=")
    return keyword.lower(), [rest, *parts[1:]] if equals and rest else parts[1:]


def matches(pattern: str) -> list[Path]:
    """Return the files that an `Include` means; names without a folder are below ~/.ssh."""
    full = Path("~/.ssh").expanduser() / Path(pattern).expanduser()
    return [Path(name) for name in sorted(glob.glob(str(full)))]  # noqa: PTH207 - the pattern may be absolute
