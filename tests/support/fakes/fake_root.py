"""A made-up file system root with network interfaces, as /sys and /proc show them."""

from __future__ import annotations

import shutil
from pathlib import Path

ROUTES = "Iface Destination Gateway Flags RefCnt Use Metric Mask MTU Window IRTT\n"


class FakeRoot:
    def __init__(self, path: Path) -> None:
        self.path = path
        (path / "proc/self/net").mkdir(parents=True)
        (path / "sys/class/net").mkdir(parents=True)

    def add(
        self,
        name: str,
        mac: str,
        index: int,
        *,
        device: bool = True,
        wireless: bool = False,
        kind: int = 1,
        **more: str,
    ) -> None:
        """Add an interface; `more` are attributes such as phy80211/macaddress, __ for the slash."""
        place = self.path / "sys/class/net" / name
        place.mkdir()
        (place / "address").write_text(f"{mac}\n")
        (place / "ifindex").write_text(f"{index}\n")
        (place / "type").write_text(f"{kind}\n")
        for wanted, entry in ((device, "device"), (wireless, "wireless")):
            if wanted:
                (place / entry).mkdir()
        for key, value in more.items():
            file = place / key.replace("__", "/")
            file.parent.mkdir(exist_ok=True)
            file.write_text(f"{value}\n")

    def remove(self, name: str) -> None:
        shutil.rmtree(self.path / "sys/class/net" / name)

    def route(self, *routes: tuple[str, int]) -> None:
        lines = [
            f"{name} 00000000 0101A8C0 0003 0 0 {metric} 00000000 0 0 0" for name, metric in routes
        ]
        local = "eth0 0001A8C0 00000000 0001 0 0 0 00FFFFFF 0 0 0"
        (self.path / "proc/self/net/route").write_text(ROUTES + "\n".join([local, *lines]) + "\n")
