"""The links to the relays of the site's other cells: who owns which robot, stops, and where requests are forwarded."""
