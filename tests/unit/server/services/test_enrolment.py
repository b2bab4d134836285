"""Playbooks that register robots, and many robots that come at once."""

from __future__ import annotations

import dataclasses
import datetime as dt
import threading
from collections.abc import Callable

import pytest
from joins import KEY, MAC, OTHER_KEY, OTHER_MAC, REPORT, Site, key
from robot_signer import RobotSigner
from robotether_server.db import Database, audit, credentials, robots, seen_robots
from robotether_server.db.audit import Source
from robotether_server.db.robots import Robot
from robotether_server.problems import (
    FieldInvalid,
    KeyInUse,
    KeyRejected,
    MacInUse,
    Problem,
    RecordExists,
    RecordRefused,
    RobotDisabled,
    StoreUnavailable,
    TokenUsedUp,
)
from robotether_server.services import enrolment_credentials
from robotether_server.services import robots as robot_service
from robotether_server.services.enrolment import Registration
from robotether_server.services.enrolment_credentials import EnrolmentCredential
from robotether_server.services.joining import Answer

ADMIN = Source("root", "192.0.2.9")
NEW_MAC = "00:1b:44:00:61:77"


@pytest.fixture(scope="module")
def signer(tmp_path_factory: pytest.TempPathFactory) -> RobotSigner:
    """The key that the playbook made on its robot."""
    return RobotSigner(tmp_path_factory.mktemp("robot"))


def register(
    site: Site,
    signer: RobotSigner,
    name: str = "turtle",
    mac: str = NEW_MAC,
    *,
    token: str | None = None,
    local: bool = False,
) -> tuple[Robot, bool]:
    with site.database.transaction() as tx:
        credential = enrolment_credentials.find(tx, token) if token else EnrolmentCredential("root")
        asked = Registration(name, mac, signer.line, credential, "turtle", "0.1", local)
        return robot_service.register(tx, ADMIN, asked)


def join_token(site: Site, uses: int) -> str:
    later = dt.datetime.now(dt.UTC) + dt.timedelta(hours=1)
    with site.database.transaction() as tx:
        return credentials.create_join_token(tx, "lab", uses, later, "root")


def uses(site: Site) -> int:
    with site.database.transaction() as tx:
        return credentials.list_join_tokens(tx)[0].used


def claims_of(site: Site) -> int:
    with site.database.transaction() as tx:
        return len(robots.list_claims(tx))


def test_new_robot_is_made_and_active(site: Site, signer: RobotSigner) -> None:
    """Asking again changes nothing and uses no token up."""
    token = join_token(site, 1)
    robot, is_made = register(site, signer, token=token)
    assert (robot.name, robot.mac, robot.state, is_made) == ("turtle", NEW_MAC, "active", True)
    assert (robot.key, robot.is_unknown) == (signer.key, False)
    assert register(site, signer, token=token) == (robot, False)
    with site.database.transaction() as tx:
        assert robots.get(tx, "turtle") == robot
    assert uses(site) == 1
    (event,) = site.events("robot_approved")
    assert (event["robot"], event["actor"], event["address"]) == ("turtle", "root", "192.0.2.9")


def test_used_up_token_makes_no_robot(site: Site, signer: RobotSigner) -> None:
    """And leaves no row; nor does it let in again whom an admin removed."""
    token = join_token(site, 1)
    register(site, signer, token=token)
    with site.database.transaction() as tx:
        robot_service.remove(tx, ADMIN, "turtle")
    with pytest.raises(TokenUsedUp, match="an admin has undone that"):
        register(site, signer, token=token)
    assert site.names() == ["sim1"]


def test_announced_robot_takes_the_key(site: Site, signer: RobotSigner) -> None:
    """In place of one that only waits there, too."""
    site.announce("turtle", NEW_MAC)
    site.ask(NEW_MAC, OTHER_KEY)
    robot, is_made = register(site, signer)
    assert (robot.state, robot.key, is_made) == ("active", signer.key, False)


def test_unknown_robot_keeps_neither_mac_nor_key_nor_name(site: Site, signer: RobotSigner) -> None:
    """Its row gets the playbook's name; the key that it showed elsewhere is free."""
    site.ask(NEW_MAC, OTHER_KEY)
    site.ask(OTHER_MAC, signer.key)
    robot, _ = register(site, signer)
    assert (robot.name, robot.key) == ("turtle", signer.key)
    assert site.names() == ["sim1", "turtle"]


def test_what_belongs_to_another_is_told_apart(site: Site, signer: RobotSigner) -> None:
    """Each refusal says what to do, and changes nothing."""
    with pytest.raises(MacInUse, match="robotether robot rekey sim1"):
        register(site, signer, "sim1", MAC)
    site.announce("turtle", NEW_MAC)
    with pytest.raises(RecordExists, match="belongs to robot turtle"):
        register(site, signer, "other", NEW_MAC)
    with pytest.raises(RecordExists, match="another robot has the name sim1"):
        register(site, signer, "sim1", OTHER_MAC)
    register(site, signer)
    with pytest.raises(KeyInUse):
        register(site, signer, "third", OTHER_MAC)
    assert site.robot("sim1").key == KEY
    assert site.names() == ["sim1", "turtle"]


def test_disabled_robot_and_rejected_key_stay_out(site: Site, signer: RobotSigner) -> None:
    """A playbook does not undo what an admin decided."""
    register(site, signer)
    site.set_state("turtle", "disabled")
    with pytest.raises(RobotDisabled):
        register(site, signer)
    with site.database.transaction() as tx:
        robots.add_rejected_key(tx, robots.get(tx, "turtle"), "root")
        robot_service.remove(tx, ADMIN, "turtle")
    with pytest.raises(KeyRejected, match="sudo robotether-agent forget"):
        register(site, signer)


def test_what_is_no_name_mac_or_key_is_refused(site: Site, signer: RobotSigner) -> None:
    """A locally administered MAC too, unless it is allowed or announced."""
    with pytest.raises(RecordRefused, match="a name has a-z"):
        register(site, signer, "No Name")
    with pytest.raises(FieldInvalid, match="cannot use mac"):
        register(site, signer, mac="ff:ff:ff:ff:ff:ff")
    with pytest.raises(FieldInvalid, match="locally administered"):
        register(site, signer, mac="02:00:00:00:00:01")
    assert register(site, signer, mac="02:00:00:00:00:01", local=True)[1]


def ask_again(ask: Callable[[int], Answer], number: int, tries: int = 10) -> Answer:
    """Ask until there is a turn, as agents do: a busy machine has fewer than twenty in the time that web waits.

    A database that refused, for a deadlock say, is the problem's cause, and is not asked again.
    """
    try:
        return ask(number)
    except StoreUnavailable as problem:
        if problem.__cause__ is not None or tries == 1:
            raise
    return ask_again(ask, number, tries - 1)


def all_at_once(count: int, ask: Callable[[int], Answer]) -> tuple[list[Answer], list[Problem]]:
    """Let that many robots ask, each in a thread."""
    answers: list[Answer] = []
    problems: list[Problem] = []
    together = threading.Barrier(count)

    def run(number: int) -> None:
        together.wait(20)
        try:
            answers.append(ask_again(ask, number))
        except Problem as problem:
            problems.append(problem)

    threads = [threading.Thread(target=run, args=(number,)) for number in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    return answers, problems


def test_joins_at_once_leave_no_double_row(database: Database) -> None:
    """The same robot twenty times; twenty robots of one maker; twenty keys of one MAC."""
    site = Site(database, limit=100)
    assert all_at_once(20, lambda _: site.ask()) == ([site.ask()] * 20, [])
    token = join_token(site, 20)
    macs = [f"00:1b:44:00:71:{number:02x}" for number in range(20)]
    answers, problems = all_at_once(20, lambda n: site.ask(macs[n], key(n), token=token))
    assert (len({answer.robot for answer in answers}), problems, uses(site)) == (20, [], 20)
    answers, problems = all_at_once(5, lambda n: site.ask(OTHER_MAC, key(100 + n)))
    assert sorted(answer.code for answer in answers) == ["approval_pending", *["mac_in_use"] * 4]
    assert problems == []


def test_one_key_at_many_macs_at_once_gets_one(database: Database) -> None:
    """Whoever is first; the last use of a token lets one in as well."""
    site = Site(database)
    answers, problems = all_at_once(5, lambda n: site.ask(f"00:1b:44:00:72:0{n}"))
    assert (len(answers), {type(problem) for problem in problems}) == (1, {KeyInUse})
    token = join_token(site, 1)
    answers, problems = all_at_once(
        5, lambda n: site.ask(f"00:1b:44:00:73:0{n}", key(n), token=token)
    )
    assert (len(answers), {type(problem) for problem in problems}) == (1, {TokenUsedUp})


def test_admin_who_approves_while_others_join_is_heard(database: Database) -> None:
    """What was approved is what was shown."""
    site = Site(database, limit=100)
    site.announce()
    site.ask()

    def join_or_approve(number: int) -> Answer:
        if number:
            return site.ask(
                key=key(number), report=dataclasses.replace(REPORT, address=f"192.0.2.{number}")
            )
        with site.database.transaction() as tx:
            return Answer(robot_service.approve(tx, ADMIN, "sim1", KEY.fingerprint).name, "active")

    answers, problems = all_at_once(8, join_or_approve)
    assert (len(answers), problems) == (8, [])
    assert (site.robot("sim1").state, site.robot("sim1").key) == ("active", KEY)
    assert claims_of(site) == 7
    with site.database.transaction() as tx:
        assert len(audit.find(tx, audit.AuditSearch(kind="robot_approved"))) == 1
        assert len(seen_robots.list_all(tx)) == 1


def test_playbooks_at_once_make_a_robot_each(
    database: Database, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """With the last use of a token, one of them."""
    site = Site(database)
    signers = [RobotSigner(tmp_path_factory.mktemp("robot")) for _ in range(4)]
    token = join_token(site, 3)

    def run(number: int) -> Answer:
        mac = f"00:1b:44:00:74:0{number}"
        made, _ = register(site, signers[number], f"r{number}", mac, token=token)
        return Answer(made.name, "active")

    answers, problems = all_at_once(4, run)
    assert (len(answers), {type(problem) for problem in problems}) == (3, {TokenUsedUp})
    assert len(site.names()) == 3
