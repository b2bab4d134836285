"""The relay: an asyncio service between operators' browsers and robots' tunnels.

The container `relay` starts it with `python -m robotether_server.relay`. It must never parse what
comes back from a robot, never wait for the database on the way of a message, and never keep an
unbounded buffer for anybody.

    main            starts and stops the parts in order
    app             HTTP routes, one border that turns problems into answers
    access          who asks: ticket, login, token, origin
    fleet           the newest snapshot of robots and grants, read from the database
    sessions        which robots are connected, and what is known of them
    session_server  robots' sessions over TCP; one of them is a `robot_link`
    connections     operators' live connections, for rights that end and links that are lost
    rosbridge       an operator's WebSocket joined to a robot's rosbridge
    operations      which rosbridge operations a connection may send
    video           a robot's web_video_server, streamed through
    events          the fleet as server-sent events
    journal         writes sessions and audit lines, in the background
"""
