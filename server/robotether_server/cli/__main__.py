"""Lets `python -m robotether_server.cli` be the command `robotether`."""

from robotether_server.cli.main import main

main()
