"""Entry point of `python -m robotether_server.relay`."""

from robotether_server.relay.main import main

if __name__ == "__main__":
    main()
