"""/admin/groups: groups of users, whose grants every member has; /admin/sites: sites of robots.

A grant can be for all robots of a site. /admin/groups/NAME and /admin/sites/NAME: one of them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Generic

from flask import Blueprint, render_template, request

from robotether_server.api.context import context
from robotether_server.db import Transaction, join_tokens, robots, seen_robots, users
from robotether_server.db.audit import Source
from robotether_server.db.grants import GROUPS, LEVELS, SITES, Collection, Grant, Group, R, Site
from robotether_server.db.join_tokens import Place
from robotether_server.problems import RobotetherError
from robotether_server.schemas import MAX_NAME_LENGTH
from robotether_server.services import grants as grant_service
from robotether_server.web import confirmation, forms
from robotether_server.web.admin import grants
from robotether_server.web.confirmation import ConfirmedAction, Words
from robotether_server.web.forms import Saved, form


@dataclass(frozen=True, kw_only=True)
class CollectionPages(Generic[R]):
    """The pages of the groups or of the sites, and in what these differ.

    `member` is what a member is, and the name of its field. `added` is said when there is a new {member} of {name};
    `removal` asks before a member is removed. `effects` are those of the removal of {name} with {members}; `lost` says
    where robots are then whose join token names it.
    """

    collection: Collection[R]
    member: str
    added: str
    removal: ConfirmedAction
    effects: tuple[str, ...]
    lost: str
    add_member: Callable[[Transaction, Source, str, str], object]
    candidates: Callable[[Transaction, R], list[tuple[str, str]]]
    grants_of: Callable[[Transaction, str], list[Grant]]
    choices: Callable[[Transaction], grants.Choices]

    def blueprint(self) -> Blueprint:
        """Return the pages, their forms and their actions."""
        kind, members = self.collection.kind, self.collection.members
        pages = Blueprint(f"{kind}s", __name__, url_prefix=f"/{kind}s")
        form(pages, "", self.show_all)(self.add)
        pages.get("/<name>")(self.show)
        form(pages, f"/<name>/{members}", self.show)(self.put)
        grants.register_form(pages, "/<name>/grants", self.show, self.page_of)
        remove = ConfirmedAction(
            path="/<name>/remove",
            title=f"Remove {kind} {{name}}?",
            effects=(*self.effects, "{tokens}"),
            undo=f"A removed {kind} cannot be restored; add it again, with {members} and grants.",
            button="Remove",
            done=f"{kind.capitalize()} {{name}} is removed.",
            do=partial(grant_service.remove_collection, collection=self.collection),
            onward=f"/admin/{kind}s",
        )
        confirmation.register(pages, self.page_of("{name}"), self.words, self.removal, remove)
        return pages

    def show_all(self, problem: RobotetherError | None = None) -> str:
        """Show every group or site, with the problem of the form that adds one."""
        with context().database.transaction() as tx:
            records = self.collection.list_all(tx)
        return render_template(
            "admin/collections.html",
            collection=self.collection,
            records=records,
            problem=problem,
            values=request.form,
        )

    def add(self, tx: Transaction, source: Source) -> Saved:
        """Add a group or a site."""
        kind, name = self.collection.kind, forms.text("name", "Name", MAX_NAME_LENGTH)
        grant_service.add_collection(tx, source, self.collection, name)
        done = f"{kind.capitalize()} {name} is added. Add {self.member}s and grants to it."
        return self.page_of(name), done

    def show(self, name: str, problem: RobotetherError | None = None) -> str:
        """Show one group or site, with the problem of one of its forms."""
        with context().database.transaction() as tx:
            record = self.collection.get(tx, name)
            return render_template(
                "admin/collection.html",
                collection=self.collection,
                member=self.member,
                record=record,
                path=self.page_of(name),
                candidates=self.candidates(tx, record),
                grants=self.grants_of(tx, name),
                choices=self.choices(tx),
                levels=LEVELS,
                problem=problem,
                values=request.form,
            )

    def put(self, tx: Transaction, source: Source, name: str) -> Saved:
        """Make a user a member, or put a robot at this site."""
        member = forms.text(self.member, self.member.capitalize(), grants.MAX_CHOICE_LENGTH)
        if self.member == "robot":
            member = forms.chosen_robot(tx, member)
        self.add_member(tx, source, name, member)
        return self.page_of(name), self.added.format(name=name, member=member)

    def page_of(self, name: str) -> str:
        """Return the path of one group's or site's page."""
        return f"/admin/{self.collection.kind}s/{name}"

    def words(self, name: str, **member: str) -> Words:
        """Return what the texts of actions name; raise RecordMissingError."""
        with context().database.transaction() as tx:
            record = self.collection.get(tx, name)
            meant = [str(record.id)]
            if "user" in member:
                meant.append(str(users.get(tx, member["user"]).id))
            elif "robot" in member:
                meant.append(robots.get(tx, member["robot"]).mac)
            tokens = ", ".join(join_tokens.names_for(tx, Place(**{self.collection.kind: name})))
        return {
            "name": name,
            "meant": " ".join(meant),
            **member,
            "members": ", ".join(record.members) or "none",
            "tokens": tokens
            and f"Robots that join with these tokens will be {self.lost}: {tokens}.",
        }


def _other_users(tx: Transaction, group: Group) -> list[tuple[str, str]]:
    names = [user.name for user in users.list_all(tx)]
    return [(name, name) for name in names if name not in group.members]


def _other_robots(tx: Transaction, site: Site) -> list[tuple[str, str]]:
    robots = [seen.robot for seen in seen_robots.list_all(tx) if seen.robot.site != site.name]
    return [
        (
            forms.robot_option(robot),
            f"{robot.name} (now at {robot.site})" if robot.site else robot.name,
        )
        for robot in robots
    ]


GROUP_PAGES = CollectionPages(
    collection=GROUPS,
    member="user",
    added="User {member} is a member of group {name}.",
    removal=ConfirmedAction(
        path="/<name>/members/<user>/remove",
        title="Remove {user} from group {name}?",
        effects=(
            "{user} loses what only the grants of group {name} allow; "
            "connections that need them are cut within 2 seconds.",
        ),
        undo="Add {user} again.",
        button="Remove",
        done="User {user} is no longer a member of group {name}.",
        do=grant_service.remove_member,
    ),
    effects=(
        "Its grants are removed with it: what only these allow ends within 2 seconds. Members: {members}.",
        "The users stay.",
    ),
    lost="given to no group",
    add_member=grant_service.add_member,
    candidates=_other_users,
    grants_of=grants.of_group,
    choices=grants.scopes,
)
SITE_PAGES = CollectionPages(
    collection=SITES,
    member="robot",
    added="Robot {member} is at site {name}.",
    removal=ConfirmedAction(
        path="/<name>/robots/<robot>/take-out",
        title="Remove robot {robot} from site {name}?",
        effects=(
            "Users lose what only the grants for site {name} allow on {robot}. Connections that need them are "
            "cut within 2 seconds; if one of them drives the robot, it stops by itself.",
        ),
        undo="Add {robot} again.",
        button="Remove",
        done="Robot {robot} is at no site.",
        do=grant_service.remove_robot,
    ),
    effects=(
        "The grants for it are removed with it; connections that need them are cut within 2 seconds.",
        "Its robots stay, at no site: {members}.",
    ),
    lost="at no site",
    add_member=lambda tx, source, name, robot: grant_service.place_robot(tx, source, robot, name),
    candidates=_other_robots,
    grants_of=grants.for_site,
    choices=grants.holders,
)

blueprint = Blueprint("groups_and_sites", __name__)
for collection_pages in (GROUP_PAGES, SITE_PAGES):
    blueprint.register_blueprint(collection_pages.blueprint())
