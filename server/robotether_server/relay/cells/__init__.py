"""The machines of a site: which cells there are, who has which robot, and how robots and requests move between them."""
