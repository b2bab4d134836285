"""Who asks and what for: tickets, logins, tokens, and the live connections that a lost right ends."""
