"""What admins and playbooks do to robots' rows, also many at once."""

import dataclasses
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from joins import KEY, MAC, OTHER_KEY, OTHER_MAC, REPORT, Site, key
from robot_signer import RobotSigner
from robotether_server.db import audit, robots
from robotether_server.db.audit import Source
from robotether_server.problems import (
    FieldInvalidError,
    KeyInUseError,
    KeyRejectedError,
    MacInUseError,
    NotPossibleError,
    RecordExistsError,
    RobotDisabledError,
    StoreUnavailableError,
)
from robotether_server.services import joining
from robotether_server.services import robots as robot_service
from robotether_server.services.joining import EnrolmentCredential
from robotether_server.services.robots import Registration

ADMIN = Source("root", "192.0.2.9")


def do(site, action, *args, **options):
    with site.database.transaction() as tx:
        return action(tx, ADMIN, *args, **options)


def logged(site):
    with site.database.transaction() as tx:
        found = audit.find(tx, audit.AuditSearch(actor="root"))
    return [(event.kind, event.robot, event.address) for event in reversed(found)]


def details(site, kind):
    return site.events(kind)[0].details


def test_unknown_robot_does_not_keep_its_mac_from_being_announced(site):
    """Its key waits on under the admin's name, also where first keys get in unseen."""
    first_key = dataclasses.replace(site, policy="first-key")
    first_key.ask(OTHER_MAC, OTHER_KEY)
    robot = do(site, robot_service.add, OTHER_MAC, "turtle")
    assert (robot.state, robot.key, robot.is_unknown) == ("pending", OTHER_KEY, False)
    assert first_key.ask(OTHER_MAC, OTHER_KEY).code == "approval_pending"
    assert site.names() == ["sim1", "turtle"]


def test_unknown_robot_does_not_keep_its_mac_from_another_robot(site):
    """Anybody who knows the new card's MAC could; asking again, its key is a claim."""
    with pytest.raises(FieldInvalidError, match=r"locally administered.*--allow-local-mac"):
        do(site, robot_service.set_mac, "sim1", "02:00:00:00:00:02")
    assert site.ask(OTHER_MAC, OTHER_KEY).code == "approval_pending"
    assert do(site, robot_service.set_mac, "sim1", OTHER_MAC).mac == OTHER_MAC
    assert site.names() == ["sim1"]
    assert details(site, "key_released")["fingerprint"] == OTHER_KEY.fingerprint
    assert site.ask(OTHER_MAC, OTHER_KEY).code == "mac_in_use"


def test_approved_is_the_key_that_was_compared(site):
    site.announce("turtle", OTHER_MAC)
    with pytest.raises(NotPossibleError, match="it has not joined yet"):
        do(site, robot_service.approve, "turtle", "SHA256:b")
    site.ask(OTHER_MAC, OTHER_KEY)
    with pytest.raises(NotPossibleError, match="its key is SHA256:b, not SHA256:c"):
        do(site, robot_service.approve, "turtle", "SHA256:c")
    for _ in range(2):
        robot = do(site, robot_service.approve, "turtle", "SHA256:b")
        assert (robot.state, robot.key) == ("active", OTHER_KEY)
    assert logged(site) == [("robot_approved", "turtle", "192.0.2.9")]


def test_approved_claim_replaces_the_key(site):
    """The connections of the old key end, those of a rotation before it too; no other robot gets it."""
    site.ask(key=OTHER_KEY)
    site.announce("turtle", OTHER_MAC)
    for action in (robot_service.approve, robot_service.reject):
        with pytest.raises(NotPossibleError):
            do(site, action, "turtle", "SHA256:b")
    with pytest.raises(NotPossibleError, match="robotether robot rekey sim1"):
        do(site, robot_service.reject, "sim1", "SHA256:a")
    do(site, robot_service.disable, "sim1")
    with pytest.raises(NotPossibleError, match="robotether robot enable sim1"):
        do(site, robot_service.approve, "sim1", "SHA256:b")
    do(site, robot_service.enable, "sim1")
    robot = do(site, robot_service.approve, "sim1", "SHA256:b")
    assert (robot.state, robot.key, robot.report) == ("active", OTHER_KEY, REPORT)
    with site.database.transaction() as tx:
        assert robots.list_waiting(tx) == []
        assert tx.rows("SELECT previous_fingerprint AS p FROM robots") == [{"p": None}] * 2
    assert details(site, "robot_approved")["replaced"] == "SHA256:a"
    assert site.ask().code == "mac_in_use"


@pytest.mark.parametrize("is_announced", [True, False])
def test_rejected_key_is_remembered(site, is_announced):
    """An unknown robot's row goes with it; an announced robot waits for its first key again."""
    if is_announced:
        site.announce("robot-006102", OTHER_MAC)
    site.ask(OTHER_MAC, OTHER_KEY)
    with site.database.transaction() as tx:
        robot_service.reject(tx, ADMIN, "robot-006102", "SHA256:b")
        (rejected,) = robots.list_rejected_keys(tx)
    assert (rejected.robot, rejected.rejected_by) == ("robot-006102", "root")
    assert rejected.fingerprint == OTHER_KEY.fingerprint
    assert site.names() == (["robot-006102", "sim1"] if is_announced else ["sim1"])
    if is_announced:
        assert site.robot("robot-006102").key is None
    assert logged(site) == [("key_rejected", "robot-006102", "192.0.2.9")]


def test_disabled_robot_comes_back_as_it_was(site):
    """A key that waited is not approved by the way."""
    waiting = site.ask(OTHER_MAC, OTHER_KEY).robot
    for name, state, key_after in (("sim1", "active", KEY), (waiting, "pending", None)):
        for _ in range(2):
            assert do(site, robot_service.disable, name).state == "disabled"
        robot = do(site, robot_service.enable, name)
        assert (robot.state, robot.key) == (state, key_after)
    with pytest.raises(NotPossibleError, match="it is active, not disabled"):
        do(site, robot_service.enable, "sim1")
    assert [kind for kind, _, _ in logged(site)] == ["robot_disabled", "robot_enabled"] * 2


def test_changes_keep_the_rest_and_are_logged_once(site):
    for _ in range(2):
        robot = do(site, robot_service.set_mac, "sim1", "001b.4400.6102")
        do(site, robot_service.set_shell, "sim1", True)
        do(site, robot_service.change_settings, "sim1", lambda _present: {"shell_user": "pi"})
        do(site, robot_service.rotate_key, "sim1")
        do(site, robot_service.rename, "sim1", "sim1")
    moved = do(site, robot_service.move_ports, "sim1")
    chosen = do(site, robot_service.move_ports, "sim1", 30000, 30005)
    renamed = do(site, robot_service.rename, "sim1", "turtle")
    assert robot.mac == OTHER_MAC
    assert moved.ros_port != robot.ros_port
    assert (chosen.ros_port, chosen.video_port) == (30000, 30005)
    assert (renamed.id, renamed.name, renamed.key) == (robot.id, "turtle", KEY)
    assert (renamed.shell_port, renamed.settings) == (24000, {"shell_user": "pi"})
    assert renamed.rotate_requested_at is not None
    changes = ("mac_set", "shell_set", "settings_set", "rotation_requested", *["ports_moved"] * 2)
    expected = [(f"robot_{change}", "sim1", "192.0.2.9") for change in changes]
    assert logged(site) == [*expected, ("robot_renamed", "turtle", "192.0.2.9")]
    assert details(site, "robot_mac_set") == {"was": MAC, "mac": OTHER_MAC}
    assert do(site, robot_service.set_shell, "turtle", False).shell_port is None
    do(site, robot_service.change_settings, "turtle", lambda _present: {})
    assert site.robot("turtle").settings == {}


def test_change_of_the_page_changes_nothing_else(site):
    """Managers set the page, and only admins the guard's limits."""
    page = {"kind": "holonomic"}
    wider = {"page": page, "guard": {"max_speed_m_s": 9}}
    do(site, robot_service.change_settings, "sim1", lambda _present: wider, "page")
    assert site.robot("sim1").settings == {"page": page}
    assert details(site, "robot_page_set") == {"was": None, "page": page}


def test_rekeyed_robot_has_no_key(site):
    robot = do(site, robot_service.rekey, "sim1")
    assert (robot.state, robot.key) == ("pending", None)
    assert details(site, "robot_rekeyed") == {"was": "active", "fingerprint": "SHA256:a"}
    with pytest.raises(NotPossibleError, match="only an active robot"):
        do(site, robot_service.rotate_key, "sim1")
    do(site, robot_service.disable, "sim1")
    assert do(site, robot_service.rekey, "sim1").state == "disabled"


NEW_MAC = "00:1b:44:00:61:77"


@pytest.fixture(scope="module")
def signer():
    return RobotSigner()


def register(site, signer, name="turtle", mac=NEW_MAC, *, token=None, local=False):
    with site.database.transaction() as tx:
        credential = joining.find_credential(tx, token) if token else EnrolmentCredential("root")
        proof = signer.proof(mac) if token else None
        asked = Registration(name, mac, signer.line, credential, proof, "turtle", "0.1", local)
        return robot_service.register(tx, ADMIN, asked)


def test_new_robot_is_made_and_active(site, signer):
    with pytest.raises(FieldInvalidError, match="locally administered"):
        register(site, signer, mac="02:00:00:00:00:01")
    token = site.join_token(1)
    robot, is_made = register(site, signer, token=token)
    assert (robot.name, robot.mac, robot.state, is_made) == ("turtle", NEW_MAC, "active", True)
    assert (robot.key, robot.is_unknown) == (signer.key, False)
    assert register(site, signer, token=token) == (robot, False)
    with site.database.transaction() as tx:
        assert robots.get(tx, "turtle") == robot
    assert site.used() == 1
    (event,) = site.events("robot_approved")
    assert (event.robot, event.actor, event.address) == ("turtle", "root", "192.0.2.9")


def test_unknown_robot_keeps_neither_mac_nor_key_nor_name(site, signer):
    """Its row gets the playbook's name; the key that it showed elsewhere is free."""
    site.ask(NEW_MAC, OTHER_KEY)
    site.ask(OTHER_MAC, signer.key)
    robot, _ = register(site, signer)
    assert (robot.name, robot.key) == ("turtle", signer.key)
    assert site.names() == ["sim1", "turtle"]


def test_what_belongs_to_another_is_told_apart(site, signer):
    """Each refusal says what to do, and changes nothing."""
    with pytest.raises(MacInUseError, match="robotether robot rekey sim1"):
        register(site, signer, "sim1", MAC)
    site.announce("turtle", NEW_MAC)
    with pytest.raises(RecordExistsError, match="belongs to robot turtle"):
        register(site, signer, "other", NEW_MAC)
    with pytest.raises(RecordExistsError, match="another robot has the name sim1"):
        register(site, signer, "sim1", OTHER_MAC)
    robot, is_made = register(site, signer)
    assert (robot.state, robot.key, is_made) == ("active", signer.key, False)
    with pytest.raises(KeyInUseError):
        register(site, signer, "third", OTHER_MAC)
    assert site.robot("sim1").key == KEY
    assert site.names() == ["sim1", "turtle"]


def test_disabled_robot_and_rejected_key_stay_out(site, signer):
    """A playbook does not undo what an admin decided."""
    register(site, signer)
    site.set_state("turtle", "disabled")
    with pytest.raises(RobotDisabledError):
        register(site, signer)
    with site.database.transaction() as tx:
        turtle = robots.get(tx, "turtle")
        robots.reject_claim(
            tx, robots.add_claim(tx, turtle, turtle.key, turtle.report), "turtle", "root"
        )
        robot_service.remove(tx, ADMIN, "turtle")
    with pytest.raises(KeyRejectedError, match="sudo robotether-agent forget"):
        register(site, signer)


def ask_again(ask, number, tries=10):
    """Ask until there is a turn, as agents do: a busy machine has fewer than twenty in the time that web waits.

    A database that refused, for a deadlock say, is the problem's cause, and is not asked again.
    """
    try:
        return ask(number)
    except StoreUnavailableError as problem:
        if problem.__cause__ is not None or tries == 1:
            raise
    return ask_again(ask, number, tries - 1)


def all_at_once(count, ask):
    """Answers of as many threads."""
    together = threading.Barrier(count)

    def run(number):
        together.wait(20)
        return ask_again(ask, number)

    with ThreadPoolExecutor(count) as threads:
        return list(threads.map(run, range(count)))


def test_joins_at_once_leave_no_double_row(database):
    site = Site(database, limit=100)
    assert all_at_once(20, lambda _: site.ask()) == [site.ask()] * 20
    token = site.join_token(20)
    macs = [f"00:1b:44:00:71:{number:02x}" for number in range(20)]
    answers = all_at_once(20, lambda n: site.ask(macs[n], key(n), token=token))
    assert (len({answer.robot for answer in answers}), site.used()) == (20, 20)
    answers = all_at_once(5, lambda n: site.ask(OTHER_MAC, key(100 + n)))
    assert sorted(answer.code for answer in answers) == ["approval_pending", *["mac_in_use"] * 4]


def test_who_changes_a_robot_waits_for_joins_and_not_for_ever(site, monkeypatch):
    monkeypatch.setattr(robots, "LOCK_WAIT_S", 0)
    with site.database.transaction() as tx:
        robots.lock_enrolment(tx)
        with pytest.raises(StoreUnavailableError, match="try again"):
            do(site, robot_service.disable, "sim1")
