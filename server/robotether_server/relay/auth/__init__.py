"""Authorization: tickets, logins, tokens, and the live connections that a lost right ends."""
