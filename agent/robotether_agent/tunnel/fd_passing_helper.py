"""Hands OpenSSH's client the connection that the agent made: the program behind its ProxyCommand.

Started by ssh with ProxyUseFdpass: stdin and stdout lead to ssh, and stderr, which ssh passes on, is a Unix socket in
which the agent has left the connection. It imports nothing but two built-in modules, since each start of a tunnel waits
for it, and must never speak on the connection.
"""

import _socket
import sys

BYTES_OF_A_DESCRIPTOR = 4


def main() -> int:
    """Take one descriptor out of stderr and put it into stdout."""
    agent, ssh = _socket.socket(fileno=2), _socket.socket(fileno=1)
    _, control, _, _ = agent.recvmsg(1, _socket.CMSG_LEN(BYTES_OF_A_DESCRIPTOR))
    if not control:
        sys.stderr.write("robotether-agent left no connection\n")
        return 1
    _, _, descriptor = control[0]
    ssh.sendmsg([b"\0"], [(_socket.SOL_SOCKET, _socket.SCM_RIGHTS, descriptor)])
    # Both numbers belong to this process' standard streams, which nobody else closes.
    agent.detach()
    ssh.detach()
    return 0


if __name__ == "__main__":
    sys.exit(main())
