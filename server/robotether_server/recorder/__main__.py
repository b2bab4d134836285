"""`python3 -m robotether_server.recorder` runs the recorder."""

from robotether_server.recorder.main import main

main()
