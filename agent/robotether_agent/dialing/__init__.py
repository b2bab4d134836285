"""How this robot reaches its server: names, addresses, ports, an HTTP proxy, and the sockets that OpenSSH gets.

`dialer` asks for a way, and hands what comes to `tunnel`. Must never take for the server what only accepts.

    way              whichever port, address and proxy works now: `race` tries several side by side
    resolver, tcp    the name's addresses, and connections to them; `http_proxy` is CONNECT through a proxy
    banner           whether SSH is behind it
    socket_options   what the kernel is told about each connection; `paths` asks it whether one still fits
    handover         gives the connection to OpenSSH's client, which starts `pass_socket` to take it
"""
