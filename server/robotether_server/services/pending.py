"""Joins that were refused, and rejected keys that may ask again."""

from robotether_server.db import Transaction, audit, robots
from robotether_server.db.audit import Source, network_of
from robotether_server.db.robots import RefusedJoin, RejectedKey
from robotether_server.services.joining import PresentedKey


def record_refusal(tx: Transaction, presented: PresentedKey, code: str, detail: str) -> None:
    """Keep why this robot was refused, for the admin who waits for it."""
    now, key = tx.now(), presented.key.fingerprint
    refusal = RefusedJoin(presented.mac, key, presented.report, code, detail, 1, now)
    robots.record_refusal(tx, refusal, str(network_of(presented.report.address)))


def forget_refusals(tx: Transaction, presented: PresentedKey) -> None:
    """Forget what was refused to a key that is in now, or waits."""
    robots.remove_refusals(tx, presented.mac, presented.key.fingerprint)


def host_key_refused(robot: str) -> str:
    """Say that a robot refuses the host key that it gets from SSH, and what to do."""
    return (
        f"robot {robot} does not connect: the SSH host key that it gets is not one of those pinned at its first join. "
        "Somebody may be posing as this server there. Only if its host keys were changed on purpose: remove "
        "/var/lib/robotether-agent/known_hosts on the robot, and start its agent again"
    )


def forgive(tx: Transaction, source: Source, rejected_id: int) -> RejectedKey:
    """Let a rejected key ask again, and return it; raise RecordMissingError."""
    key = robots.get_rejected_key(tx, rejected_id)
    robots.remove_claim(tx, key.id)
    audit.record(tx, source, "key_forgiven", key.robot, mac=key.mac, fingerprint=key.fingerprint)
    return key
