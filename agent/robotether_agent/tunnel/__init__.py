"""One SSH connection to the server, and the session on it.

A connection ends with the problem that ended it; the daemon tries again.

    connection    one attempt, on whichever port answers: the tunnel, its forward, its session, until a problem ends it
    tunnel        OpenSSH's client as a child process; `openssh` is its command lines and its last words,
                  and starts `fd_passing_helper`, which takes the connection that we made
    session       the protocol on it
    liveness      ends a connection that is dead
"""
