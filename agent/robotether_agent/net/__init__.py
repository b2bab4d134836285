"""How this robot reaches its server: names, addresses, ports, an HTTP proxy, and the sockets that OpenSSH gets.

`tunnel` asks for a connection. Must never take for the server what only accepts.

    server_dialer    whichever port, address and proxy works now: `happy_eyeballs` tries several side by side
    resolver, tcp    the name's addresses, and connections to them; `http_proxy` is CONNECT through a proxy
    banner           whether SSH is behind it
    socket_options   what the kernel is told about each connection; `paths` asks it whether one still fits
    netlink          reports changes of the network
    fd_passing       gives the connection to OpenSSH's client, which starts `fd_passing_helper` to take it
"""
