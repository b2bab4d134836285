"""A rosbridge v2 server on a WebSocket: the simulated robot's port 9090.

server.py takes connections, client.py is one of them, operations.py has one function a kind of
operation and the one list of all, rosapi.py the services that tell what there is.
"""
