"""The relay: an asyncio service between operators' browsers and robots' tunnels.

The container `relay` starts it with `python -m robotether_server.relay`. It must never parse what
comes back from a robot, never wait for the database on the way of a message, and never keep an
unbounded buffer for anybody.

    main             the process: settings, log, signals
    relay            makes the parts, joins them, starts and stops them in order
    app              HTTP routes, and the border that turns problems into answers
    means, retry     what the handlers need alike; how long to wait before the next try

    fleet            the newest robots and rights, read from the database
    sessions         which robots are connected, and what is known of them
    connections      operators' live connections, for rights that end and links that are lost
    control          who drives, who waits, who stopped; `leasing` gives leases by the rules of `leases`,
                     `stops` stops and releases
    board            the fleet as operators see it, and who has yet to be told of what
    reports          log, audit and metrics of what happens

    access           who asks, and what for: ticket, login, token, origin; `credentials` looks up
    rosbridge        lets an operator in; `reach` opens the way to the robot, `bridge` passes the
                     messages on, `operations` says which by `policy` and checks their `fields`,
                     `liveness` when a side is slow or silent, `sockets` are its two ends,
                     `endings` its close codes, `own_operations` are for the relay itself;
                     `json_text` reads and writes messages, `drive_commands` are the ones that move,
                     `subscriptions` are counted, `redirects` of a robot are not followed
    drive_path       a driver's commands: their age by `ages` and `clocks`, the newest first, and the
                     drive's books in `drive_log`, its round trips in `latencies`
    control_api      stop, release and lease over HTTP
    video            a robot's web_video_server, streamed through; `video_headers` says what of it
    events           the fleet as server-sent events

    session_server   robots' sessions over TCP; `robot_link` is one, `session_messages` its lines,
                     `admission` says who may connect and stay, `allowance` how many lines,
                     `ports` waits until a robot's port is free, `checks` tries what is behind it
    journal          writes sessions and audit lines in the background
    records          the way to the database, on threads of its own
"""
