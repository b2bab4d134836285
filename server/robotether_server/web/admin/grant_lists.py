"""Which grants a page shows, and what its form for another one offers. Pure, but for its queries."""

from robotether_server.db import Transaction, grants, seen_robots, users
from robotether_server.db.grants import Grant
from robotether_server.db.robots import Robot
from robotether_server.db.users import User

# Title, and value and words of what there is to choose from.
Choices = list[tuple[str, list[tuple[str, str]]]]


def for_robot(tx: Transaction, robot: Robot) -> list[Grant]:
    """Return the grants that reach a robot: its own, its site's and those for all."""
    return [
        one
        for one in grants.list_all(tx)
        if one.is_for_all
        or one.robot == robot.name
        or (one.site is not None and one.site == robot.site)
    ]


def for_site(tx: Transaction, site: str) -> list[Grant]:
    """Return the grants that reach a site: its own and those for all."""
    return [one for one in grants.list_all(tx) if one.is_for_all or one.site == site]


def of_user(tx: Transaction, user: User) -> list[Grant]:
    """Return the grants that a user has, alone or in a group."""
    joined = {group.name for group in grants.list_groups(tx) if user.name in group.members}
    return [one for one in grants.list_all(tx) if one.user == user.name or one.group in joined]


def of_group(tx: Transaction, group: str) -> list[Grant]:
    """Return the grants that a group has."""
    return [one for one in grants.list_all(tx) if one.group == group]


def holders(tx: Transaction) -> Choices:
    """Return who may be given a grant; admins need none."""
    people = [user.name for user in users.list_all(tx) if not user.is_admin]
    return [
        ("Users", [(f"user:{name}", name) for name in people]),
        ("Groups", [(f"group:{one.name}", f"group {one.name}") for one in grants.list_groups(tx)]),
    ]


def scopes(tx: Transaction) -> Choices:
    """Return what a grant may be for."""
    names = [seen.robot.name for seen in seen_robots.list_all(tx)]
    return [
        ("Robots", [(f"robot:{name}", name) for name in names]),
        ("Sites", [(f"site:{one.name}", f"site {one.name}") for one in grants.list_sites(tx)]),
        ("Everything", [("all", "all robots, also future ones")]),
    ]
