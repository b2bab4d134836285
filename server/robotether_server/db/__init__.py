"""All SQL of the server, one module a group of tables, one function a query or a change.

Used by web, relay and cli. Every function takes the open Transaction to work in, so that a change
and its audit event are one. Nothing here decides who may do what.
"""

from robotether_server.db.database import Database, Transaction

__all__ = ["Database", "Transaction"]
