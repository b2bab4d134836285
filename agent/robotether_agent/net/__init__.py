"""How this robot reaches its server: names, addresses, ports, and an HTTP proxy.

`tunnel` asks for a connection. Must never take for the server what only accepts.

    server_dialer    whichever port, address and proxy works now, and whether SSH is behind it
    happy_eyeballs   tries several side by side and takes the first that works
    tcp              the name's addresses, connections to them, and the kernel's settings of each
    http_proxy       CONNECT through a proxy
    netlink          reports changes of the network
"""
