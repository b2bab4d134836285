"""The relay: an asyncio service between operators' browsers and robots' tunnels.

The container `relay` starts it with `python -m robotether_server.relay`. It must never parse what
comes back from a robot, never wait for the database on the way of a message, and never keep an
unbounded buffer for anybody.

    main         the process: reads settings, runs the relay until it is asked to stop
    wiring       makes the parts top down, says who is notified of what, starts and stops them
    app          HTTP routes, and the border that turns problems into answers
    observers    log, audit and metrics of what happens
    metrics      the numbers for Prometheus

    cells/       the site's other machines: who has which robot, forwarding, drain, rebalancing
    channels/    what people connect to, each kind a folder or module that imports from no other kind:
                 events     the fleet as operators see it, as server-sent events
                 rosbridge  a WebSocket joined to a robot's rosbridge: every message is checked and written again, and
                            drive commands are counted for the drive's record
                 video      a robot's cameras: the frames protocol, streams, web_video_server passed through
    control/     grants and ends leases, stops and releases robots, answers the requests for it, describes the fleet
    auth/        who asks and what for: tickets, logins, tokens, and the live connections that they opened
    robots/      one `Robot` for all that is known of a robot, sessions over TCP, and the way to robots' ports
    records/     the database on threads of its own: reads robots and rights, writes what happens
    http/        sockets, close reasons, and `timing`: rates, silence, clocks

Each folder imports only from those below it, and robots and records not from each other.
"""
