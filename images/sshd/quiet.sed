# What stays out of sshd's log, unless LOG_LEVEL is debug: health checks, and robots' log-ins, which the relay logs in one
# line with the robot's name. People's log-ins, refused keys and all else stay.
/^Server listening on /d
/^Connection from /d
/^(Connection (closed|reset) by|Received disconnect from|Disconnected from) [0-9a-f.:]+ port /d
/^Disconnected from user /d
/^kex_exchange_identification: (Connection closed by remote host|read: Connection reset by peer)/d
/^Accepted key .* found at /d
/^Postponed publickey for /d
/^Accepted publickey for tunnel /d
/^User child is on pid /d
/^(Starting session|Close session): /d
/^(Transferred: sent|Closing connection to) /d
# sshd itself ends the child of a client that is gone.
/^mm_reap: preauth child terminated by signal 15/d
