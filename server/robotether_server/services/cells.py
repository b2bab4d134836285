"""Cells are taken out of service, put back and removed by admins; each is added by its own relay."""

from robotether_server.db import Transaction, audit, cells
from robotether_server.db.audit import Source
from robotether_server.problems import NotPossibleError


def drain(tx: Transaction, source: Source, name: str) -> None:
    """Take a cell out of service; raise RecordMissingError, or NotPossibleError if no other cell takes its robots."""
    cells.lock_drains(tx)
    cell = cells.get(tx, name)
    if not any(cell.is_listed for cell in cells.read(tx) if cell.name != name):
        raise NotPossibleError(
            f"cannot drain cell {name}: no other one is alive, in service and has a PUBLIC_HOST, "
            "so that its robots have nowhere to go; see: cell list"
        )
    if not cell.draining:
        cells.set_draining(tx, name, on=True)
        audit.record(tx, source, "cell_drained", cell=name)


def resume(tx: Transaction, source: Source, name: str) -> None:
    """Put a cell back into service; raise RecordMissingError."""
    if cells.get(tx, name).draining:
        cells.set_draining(tx, name, on=False)
        audit.record(tx, source, "cell_resumed", cell=name)


def remove(tx: Transaction, source: Source, name: str) -> None:
    """Remove a lost cell, and end its sessions and drives; raise RecordMissingError or NotPossibleError."""
    if cells.get(tx, name).is_alive:
        raise NotPossibleError(f"cannot remove cell {name}: it is alive; stop its machine first")
    cells.remove(tx, name)
    audit.record(tx, source, "cell_removed", cell=name)
