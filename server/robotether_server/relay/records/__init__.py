"""The relay's access to the database: reads robots and rights, writes what happens."""
