"""One SSH connection to the server, and the session on it.

connector     gets the TCP connection (`net`), by whichever port answers
connection    one attempt: the tunnel, its forward, its session, until a problem ends it
tunnel        OpenSSH's client as a child process; `ssh_command` are its command lines, `ssh_errors` its last words
session       the protocol on it; `session_messages` are the lines about driving
liveness      ends a connection that is dead
"""
