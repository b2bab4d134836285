"""The blueprint that all modules of the API put their paths on."""

from flask import Blueprint

blueprint = Blueprint("api", __name__, url_prefix="/api/v1")
