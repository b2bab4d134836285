"""How long `robotether audit verify` takes for an exported file, on one core. Used by `bench`; needs no demo."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
from report import Section
from robotether_common.audit_head import NAMESPACE, statement
from robotether_server import audit_chain
from robotether_server.audit_chain import ChainEnd, ChainLine, Record, SignedHead
from robotether_server.cli.audit_log import read_export
from robotether_server.signatures import SigningKey

LINES, CHAINS = 1_000_000, 100
AIM_S = 60
DETAILS = json.dumps(
    {"end_code": "left", "fence": 7, "lasted_s": 61.5, "distance_m": 12.3, "top_speed_m_s": 0.5}
)


def chain_of(name: str, count: int, key: SigningKey) -> Iterator[Record]:
    """One chain with a signed head of its newest line."""
    line_hash, lines = audit_chain.start_hash(name), []
    for position in range(1, count + 1):
        line = ChainLine(
            position,
            f"1764373339.{position:06}",
            "ann",
            "drive_ended",
            name,
            "192.0.2.1",
            DETAILS,
            "",
        )
        line_hash = audit_chain.next_hash(line_hash, audit_chain.content_hash(line))
        lines.append(msgspec.structs.replace(line, hash=line_hash))
    signature = key.sign(NAMESPACE, statement(name, count, line_hash, None))
    yield ChainEnd(name, count, line_hash)
    yield SignedHead(name, count, line_hash, "server", key.public_key, None, signature)
    yield from lines


def measure(lines: int = LINES) -> Section:
    key = SigningKey("x" * 32, audit_chain.SERVER_KEY_PURPOSE)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "export.jsonl")
        with file.open("wb") as out:
            for number in range(CHAINS):
                for record in chain_of(f"sim{number}", lines // CHAINS, key):
                    out.write(msgspec.json.encode(record) + b"\n")
        begun = time.process_time()
        reports = audit_chain.check(read_export(file))
        took_s = time.process_time() - begun
        size_mb = file.stat().st_size / 1e6
    assert not any(report.fault for report in reports)
    count = sum(report.lines for report in reports)
    return Section(
        "Verifying the audit log",
        f"Processor time of `robotether audit verify` for a file that `audit export` wrote, of {CHAINS} chains. "
        f"Aim: a million lines within {AIM_S} s.",
        [{"lines": count, "file, MB": size_mb, "s": took_s, "lines a second": count / took_s}],
    )
