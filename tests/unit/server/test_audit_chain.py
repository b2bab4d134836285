"""The chains of the audit log: what was changed is found."""

import random

import msgspec
import pytest
from robot_signer import RobotSigner
from robotether_common.audit_head import NAMESPACE, statement
from robotether_server import audit_chain
from robotether_server.audit_chain import RESTORED, ChainEnd, ChainLine, SignedHead
from robotether_server.signatures import SigningKey, fingerprint

LINES = 12
SERVER = audit_chain.server_key("x" * 32)
ROBOT = RobotSigner(1)


def chain_of(count=LINES, restored=()):
    """The lines; those at the positions `restored` say that a backup was put back."""
    line_hash, lines = audit_chain.start_hash("sim1"), []
    for position in range(1, count + 1):
        line = ChainLine(
            position,
            f"1764373339.{position:06}",
            "ann\n2:x",
            RESTORED if position in restored else "robot_stopped",
            "sim1",
            "192.0.2.1" if position % 2 else None,
            '{"reason": "é"}',
            "",
        )
        line_hash = audit_chain.next_hash(line_hash, audit_chain.content_hash(line))
        lines.append(msgspec.structs.replace(line, hash=line_hash))
    return lines


def head_of(line, signer, previous=None, lost_since=None):
    text = statement("sim1", line.position, line.hash, previous)
    if signer == "server":
        key, signature = SERVER.public_key, SERVER.sign(NAMESPACE, text)
    else:
        key, signature = ROBOT.key.line, ROBOT.sign(NAMESPACE, text)
    return SignedHead(
        "sim1", line.position, line.hash, signer, key, previous, signature, lost_since
    )


def check(lines, heads, end=None, **options):
    """The report of one chain; the database counts what is there, as somebody who changes lines makes it."""
    if end is None:
        end = lines[-1] if lines else chain_of(1)[0]
    records = [ChainEnd("sim1", end.position, end.hash), *heads, *lines]
    (report,) = audit_chain.check(records, **options)
    return report


def rehash(lines):
    """Return the lines with new hashes, as an attacker without a key can make them."""
    line_hash, again = audit_chain.start_hash("sim1"), []
    for line in lines:
        line_hash = audit_chain.next_hash(line_hash, audit_chain.content_hash(line))
        again.append(msgspec.structs.replace(line, hash=line_hash))
    return again


def change(lines, dice):
    """Change, cut, swap or repeat lines, and perhaps write all hashes anew; never nothing."""
    lines, place = list(lines), dice.randrange(len(lines))
    match dice.randrange(4):
        case 0:
            field = dice.choice(("at", "actor", "kind", "robot", "address", "details"))
            new = (getattr(lines[place], field) or "") + dice.choice("0 \n:-é")
            lines[place] = msgspec.structs.replace(lines[place], **{field: new})
        case 1:
            del lines[place : place + dice.randint(1, len(lines))]
        case 2:
            other = (place + dice.randint(1, len(lines) - 1)) % len(lines)
            lines[place], lines[other] = lines[other], lines[place]
        case _:
            lines.insert(place, lines[place - 1])
    if dice.random() < 0.5:
        lines = rehash(
            msgspec.structs.replace(line, position=number) for number, line in enumerate(lines, 1)
        )
    return lines


def test_ten_thousand_changes_cuts_and_swaps_are_found(monkeypatch):
    lines = chain_of()
    heads = [head_of(lines[-1], "server"), head_of(lines[-1], "robot")]
    assert check(lines, heads).fault is None
    # The same two signatures each time.
    monkeypatch.setattr(SignedHead, "is_signed", True)
    dice = random.Random(38)
    for _ in range(10_000):
        changed = change(lines, dice)
        assert check(changed, heads).fault is not None, changed


def test_cut_end_is_found_by_the_signed_head_and_by_what_was_counted():
    lines, fault = chain_of(), "line 11 is missing; the newest was line 12"
    assert check(lines[:-2], []).fault is None
    assert check(lines[:-2], [], end=lines[-1]).fault == fault
    for signer in ("server", "robot"):
        assert check(lines[:-2], [head_of(lines[-1], signer)]).fault == fault


@pytest.mark.parametrize("kept", [True, False])
def test_deleted_lines_need_a_head_that_the_server_signed(kept):
    lines = chain_of()
    heads = [head_of(lines[4], "server" if kept else "robot"), head_of(lines[-1], "server")]
    report = check(lines[5:], heads)
    assert (report.fault is None, report.deleted) == (kept, 5 if kept else 0)
    assert check(lines[6:], heads).fault is not None


def test_robot_statement_that_was_taken_away_is_found():
    lines = chain_of()
    first = head_of(lines[2], "robot")
    second = head_of(lines[5], "robot", first.statement_hash)
    assert check(lines, [first, second]).fault is None
    assert check(lines, [second]).fault == "what the robot signed before line 6 is missing"
    assert check(lines, [first, head_of(lines[5], "robot")]).restarts == [6]


@pytest.fixture
def restored():
    """Lines after a backup was put back at line 5, and what the robot signed in order: 3, 8 of before, 9 and 12."""
    before, lines = chain_of(), chain_of(restored=[5])
    heads = [head_of(lines[2], "robot")]
    for line, since in ((before[7], 5), (lines[8], None), (lines[11], None)):
        heads.append(head_of(line, "robot", heads[-1].statement_hash, since))
    return lines, heads


def test_restored_backup_says_which_signed_lines_are_lost(restored):
    lines, heads = restored
    report = check(lines, heads)
    assert (report.fault, report.signed) == (None, {"robot": 12})
    assert [(item.line, item.lost_up_to) for item in report.restores] == [(5, 8)]
    report = check(lines[:8], heads[:1])
    assert [(item.line, item.lost_up_to) for item in report.restores] == [(5, None)]


def test_loss_is_of_the_restore_that_explains_it_or_of_each_that_may():
    """Backups were put back at 5, 8 and 11; the robot had signed 3, 6, 8 of before, and 9, then 12 of before."""
    before, lines = chain_of(13), chain_of(13, restored=[5, 8, 11])
    heads = [head_of(lines[2], "robot")]
    for line, since in ((before[5], 5), (before[7], 5), (lines[8], None), (before[11], 11)):
        heads.append(head_of(line, "robot", heads[-1].statement_hash, since))
    report = check(lines, heads)
    assert report.fault is None
    assert [(each.line, each.lost_up_to, each.perhaps_up_to) for each in report.restores] == [
        (5, 6, 8),
        (8, None, 8),
        (11, 12, None),
    ]


@pytest.mark.parametrize(
    "attack", ["no_restore", "taken_away", "in_the_log", "later_cut", "server", "before_restore"]
)
def test_restored_backup_hides_no_other_loss(restored, attack):
    """In `later_cut`, lines from 10 on are others than those of which the robot signed 12, after the restore and 9."""
    lines, heads = restored
    _, lost, fits, last = heads
    heads = {
        "no_restore": [*heads[:3], msgspec.structs.replace(last, lost_since=10)],
        "taken_away": [heads[0], fits, last],
        "in_the_log": [heads[0], msgspec.structs.replace(lost, lost_since=None), fits, last],
        "later_cut": [*heads[:3], msgspec.structs.replace(last, lost_since=5)],
        "server": [*heads, head_of(chain_of()[7], "server", lost_since=5)],
        "before_restore": [msgspec.structs.replace(heads[0], lost_since=5), *heads[1:]],
    }[attack]
    changed = [*lines[:9], msgspec.structs.replace(lines[9], actor="ben"), *lines[10:]]
    lines = rehash(changed) if attack in ("no_restore", "later_cut") else lines
    assert check(lines, heads).fault is not None


def test_heads_of_an_earlier_export_must_fit():
    older = {"sim1": [head_of(chain_of()[5], "robot")]}
    rewritten = rehash(msgspec.structs.replace(line, actor="ben") for line in chain_of())
    heads = [head_of(rewritten[-1], "server")]
    assert check(rewritten, heads).fault is None
    assert "line 6" in check(rewritten, heads, older_heads=older).fault
    assert audit_chain.check([], older_heads=older)[0].fault is not None


@pytest.mark.parametrize("deleted", [5, 10])
def test_an_export_from_before_lines_were_deleted_fits(restored, deleted):
    lines, heads = restored
    anchor = head_of(lines[deleted - 1], "server")
    kept = [head for head in heads if head.position > deleted]
    report = check(lines[deleted:], [anchor, *kept], older_heads={"sim1": heads})
    assert (report.fault, report.deleted) == (None, deleted)


def test_export_has_each_chain_once_and_heads_before_lines():
    """What stands elsewhere would not be checked, and seem to be."""
    lines, changed = chain_of(), chain_of()
    changed[3] = msgspec.structs.replace(changed[3], actor="ben")
    end, head = ChainEnd("sim1", LINES, lines[-1].hash), head_of(lines[-1], "server")
    for records in ([end, *changed, end, *lines], [end, *lines, head]):
        assert [report.fault is None for report in audit_chain.check(records)] == [False]


def test_key_of_somebody_else_signs_nothing():
    lines = chain_of()
    head = head_of(lines[-1], "server")
    own = fingerprint(SERVER.public_key)
    assert check(lines, [head], server_keys=[own]).fault is None
    assert check(lines, [head], server_keys=["SHA256:x"]).fault is not None
    forged = msgspec.structs.replace(head, public_key=SigningKey("y" * 32, "x").public_key)
    assert check(lines, [forged]).fault is not None
