"""The relay's way to the database: reads robots and rights, writes what happens."""
