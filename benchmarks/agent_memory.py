"""What the agent's processes cost a robot's memory: the real agent, connected to a fake cloud. Used by `bench`.

What is anonymous is the agent's own; the file pages of Python and its libraries count less here than on a robot without
other Python, as PSS shares a page among all processes that have it.
"""

from __future__ import annotations

import asyncio
import compileall
import shutil
import tempfile
from collections.abc import Sequence
from contextlib import AsyncExitStack
from pathlib import Path

import pandas as pd
from demo import ROOT
from fake_cloud import FakeCloud, agent_environ, eventually
from fake_rosbridge import FakeRosbridge
from openssh_server import command_line, descendants
from recording_server import running_agent
from report import Row, Section
from robotether_agent.status import read_status

# By then all that the agent starts later has started, and its first work is over.
SETTLED_AFTER_S = 10.0
AIM_MB = 45


def memory_of(pid: int) -> Row:
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()[1:]
    kb = {name: int(value.split()[0]) for name, value in (line.split(":", 1) for line in lines)}
    command = " ".join(Path(word).name for word in command_line(pid).split()[:4])
    if "python" in command:
        command = f"{Path(f'/proc/{pid}/comm').read_text().strip()} ({command})"
    return {
        "process": command,
        "PSS MB": kb["Pss"] / 1024,
        "of it anonymous": kb["Pss_Anon"] / 1024,
        "USS MB": (kb["Private_Clean"] + kb["Private_Dirty"]) / 1024,
        "RSS MB": kb["Rss"] / 1024,
    }


def installed(place: Path) -> Path:
    """Copy the agent's packages and compile them, as an installer does: Python that compiles keeps memory for it."""
    for package in ("agent/robotether_agent", "common/robotether_common"):
        shutil.copytree(ROOT / package, place / Path(package).name)
    compileall.compile_dir(place, quiet=1)
    return place


async def measured() -> list[Row]:
    async with AsyncExitStack() as stack:
        place = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="rt-")))
        rosbridge = await stack.enter_async_context(FakeRosbridge())
        cloud = FakeCloud()
        stack.push_async_callback(cloud.close)
        await cloud.start()
        urls = {"rosbridge_url": f"ws://127.0.0.1:{rosbridge.port}", "log_level": "warning"}
        packages = installed(place / "packages")
        environ = {**agent_environ(cloud, place, **urls), "PYTHONPATH": str(packages)}
        agent = await stack.enter_async_context(running_agent(environ))

        def is_connected() -> bool:
            status = read_status(place / "run")
            return status is not None and status.video_tunnel == "open"

        await eventually(is_connected, lambda: "the agent is connected", 60)
        await asyncio.sleep(SETTLED_AFTER_S)
        return [memory_of(pid) for pid in (agent, *descendants(agent))]


def rows_of(memories: Sequence[Row]) -> pd.DataFrame:
    every = pd.DataFrame(memories)
    python = every[~every.process.str.startswith("ssh ")]
    total = (
        python.sum(numeric_only=True)
        .to_frame()
        .T.assign(process=f"**Python, {len(python)} processes**")
    )
    return pd.concat([python, every.drop(python.index), total])


def measure() -> Section:
    return Section(
        title="Memory of the agent and its guard",
        text=(
            f"The agent, connected and with rosbridge, {SETTLED_AFTER_S:.0f} s after its start. PSS counts a page "
            "that several processes share once in all, USS what one process has alone.\n\n"
            f"Aim: at most {AIM_MB} MB PSS in all Python processes."
        ),
        rows=rows_of(asyncio.run(measured())),
    )
