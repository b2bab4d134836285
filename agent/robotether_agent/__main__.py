"""Lets `python -m robotether_agent` do what the console script `robotether-agent` does."""

import sys

from robotether_agent.cli import main

if __name__ == "__main__":
    sys.exit(main())
