"""Starts the simulated robot: `python -m sim_robot`. Ends on SIGTERM and SIGINT."""

import asyncio
import logging
import os
import signal
import sys

from sim_robot.settings import SimSettings, SimSettingsError, from_environment
from sim_robot.simulator import Simulator

log = logging.getLogger("sim_robot")

EXIT_SETTINGS = 78  # EX_CONFIG


def main() -> int:
    """Run until a signal comes; the exit code is 78 for settings that cannot be used."""
    try:
        settings = from_environment(os.environ)
    except SimSettingsError as problem:
        sys.stderr.write(f"{problem}\n")
        return EXIT_SETTINGS
    logging.basicConfig(
        level=settings.log_level.upper(),
        format=f"%(asctime)s %(levelname)s [{settings.name}] %(name)s: %(message)s",
    )
    return asyncio.run(_run(settings))


async def _run(settings: SimSettings) -> int:
    stopping = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stopping.set)
    try:
        async with Simulator(settings) as simulator:
            await _until_first(simulator, stopping)
    except OSError as error:
        log.error("cannot start: %s; give another SIM_ROSBRIDGE_PORT or SIM_VIDEO_PORT", error)  # noqa: TRY400  a port that is taken needs no traceback
        return 1
    log.info("stopped")
    return 0


async def _until_first(simulator: Simulator, stopping: asyncio.Event) -> None:
    waits = [asyncio.create_task(simulator.wait()), asyncio.create_task(stopping.wait())]
    done, pending = await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
    for task in pending:
        task.cancel()
    for task in done:
        task.result()  # a fault in the loop ends the program with its traceback


if __name__ == "__main__":
    sys.exit(main())
