"""The command `robotether-agent`: one module a subcommand. Only these modules print."""
