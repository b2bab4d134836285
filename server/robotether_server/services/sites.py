"""Sites of robots: admins create and remove them, and place robots."""

from robotether_server import schemas
from robotether_server.db import Transaction, audit, robots, sites
from robotether_server.db.audit import Event, Source
from robotether_server.db.robots import Robot
from robotether_server.db.sites import Site
from robotether_server.field_types import NewPlainName
from robotether_server.problems import NotPossible


def add(tx: Transaction, source: Source, name: str) -> Site:
    """Add a site without robots; raise FieldInvalid or RecordExists."""
    schemas.check("name", name, NewPlainName)
    sites.add(tx, name)
    audit.record(tx, source, Event("site_added", details={"site": name}))
    return sites.get(tx, name)


def remove(tx: Transaction, source: Source, name: str) -> Site:
    """Remove a site with its grants; return it as it was. Its robots are at no site then. Raises RecordMissing."""
    found = sites.get(tx, name)
    sites.remove(tx, found.id)
    details: dict[str, object] = {"site": name, "robots": list(found.robots)}
    audit.record(tx, source, Event("site_removed", details=details))
    return found


def place(tx: Transaction, source: Source, robot: str, site: str | None) -> Robot:
    """Put a robot at a site, or at none; raise RecordMissing."""
    found = robots.get(tx, robot)
    if found.site != site:
        sites.place(tx, found.id, None if site is None else sites.get(tx, site).id)
        details: dict[str, object] = {"was": found.site, "site": site}
        audit.record(tx, source, Event("robot_site_set", robot, details))
    return robots.get(tx, robot)


def remove_robot(tx: Transaction, source: Source, robot: str, site: str) -> Robot:
    """Put a robot of this site at none; raise RecordMissing, or NotPossible when it is not there."""
    if robots.get(tx, robot).site != site:
        raise NotPossible(f"cannot remove robot {robot} from site {site}: it is not there")
    return place(tx, source, robot, None)
