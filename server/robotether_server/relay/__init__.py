"""The relay: an asyncio service between operators' browsers and robots' tunnels.

The container `relay` starts it with `python -m robotether_server.relay`. It must never parse what
comes back from a robot, never wait for the database on the way of a message, and never keep an
unbounded buffer for anybody.

    main             the process: settings, log, signals
    relay            makes the parts, joins them, starts and stops them in order
    app              HTTP routes, and the border that turns problems into answers
    handler_context, backoff  what the handlers need alike; how long to wait before the next try

    fleet            the newest robots and rights, read from the database
    sessions         which robots are connected, and what is known of them
    connections      operators' live connections, for rights that end and links that are lost
    control          who drives, who waits, who stopped; `leasing` gives leases by the rules of `leases`,
                     `stops` stops and releases
    fleet_events  the fleet as operators see it, and who has yet to be told of what
    observers  log, audit and metrics of what happens

    access           who asks, and what for: ticket, login, token, origin; `credentials` looks up
    rosbridge        lets an operator in; `robot_dialer` opens the way to the robot, `bridge` passes the
                     messages on, `message_validator` says which by `policy` and checks their `fields`,
                     `liveness` when a side is slow or silent, `sockets` are its two ends,
                     `close_reasons` its close codes, `own_operations` are for the relay itself;
                     `json_text` reads and writes messages, `drive_commands` are the ones that move,
                     `subscriptions` are counted, `redirects` of a robot are not followed
    drive_path       a driver's commands: their age by `command_age` and `robot_clock`, the newest first, and the
                     drive's books in `drive_log`, its round trips in `latency_histogram`
    control_api      stop, release and lease over HTTP
    video            a robot's web_video_server, streamed through; `video_headers` says what of it
    events           the fleet as server-sent events

    session_server   robots' sessions over TCP; `robot_link` is one, `session_messages` its lines,
                     `authorization` says who may connect and stay, `rate_limiter` how many lines,
                     `ports` waits until a robot's port is free, `port_checks` tries what is behind it
    event_writer  writes sessions and audit lines in the background
    database  the way to the database, on threads of its own
"""
