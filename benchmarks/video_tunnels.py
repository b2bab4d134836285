"""The robot's two SSH connections as the agent makes them, with the video proxy; for behind_video.

Started by behind_video inside the robot's namespace with a directory that has `key` and `known_hosts`, then address and
port of sshd, the two ports to forward, and the congestion control of the media connection, in place of what the agent
would choose; ends with its stdin.
"""

from __future__ import annotations

import asyncio
import getpass
import logging
import os
import socket
import sys
from pathlib import Path

from robotether_agent.net.server_dialer import SshAddress
from robotether_agent.tunnel.openssh import Forward, SshFiles
from robotether_agent.tunnel.tunnel import Tunnel
from robotether_agent.video.video_proxy import VideoProxy
from robotether_common.session import Kind
from video_robot import ROS_PORT, VIDEO_PORT


async def opened(folder: Path, target: SshAddress, kind: Kind) -> Tunnel:
    """A connection of `kind` that is logged in."""
    files = SshFiles((folder / "key",), folder / "known_hosts", folder / f"{kind}.sock")
    tunnel = await Tunnel.open(target, files, kind)
    # The session command's line.
    await tunnel.lines_in.readline()
    return tunnel


async def main() -> None:
    """Keep both tunnels until stdin ends."""
    folder, host, port, ros_port, video_port, congestion = sys.argv[1:]
    target = SshAddress(host, int(port), getpass.getuser())
    proxy = VideoProxy(f"http://127.0.0.1:{VIDEO_PORT}")
    proxy_port = await proxy.start()
    session = await opened(Path(folder), target, "session")
    await session.add(Forward(int(ros_port), "127.0.0.1", ROS_PORT))
    media = await opened(Path(folder), target, "media")
    if media.socket is not None:
        media.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_CONGESTION, congestion.encode())
    proxy.use(media.socket)
    await media.add(Forward(int(video_port), "127.0.0.1", proxy_port))
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    await asyncio.to_thread(os.read, 0, 1)
    await proxy.close()
    await asyncio.gather(session.close(), media.close())


if __name__ == "__main__":
    logging.basicConfig(level=os.environ.get("LOG_LEVEL", "WARNING"))
    asyncio.run(main())
