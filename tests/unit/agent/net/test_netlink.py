"""What the kernel says about its network."""

from __future__ import annotations

import asyncio
import os

import pytest
from namespaces import ip
from robotether_agent.net.netlink import listening


@pytest.mark.skipif(os.geteuid() != 0, reason="changing an interface needs root")
async def test_the_kernel_is_heard():
    address = "127.213.17.1/32"
    with listening() as network:
        await asyncio.to_thread(ip, "address", "add", address, "dev", "lo")
        try:
            await asyncio.wait_for(network.changed(), 5)
        finally:
            await asyncio.to_thread(ip, "address", "del", address, "dev", "lo")
