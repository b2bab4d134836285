"""What is checked before any handler of the API runs."""

from __future__ import annotations

import pytest
from api_visitor import Program


@pytest.mark.parametrize(
    ("path", "code"),
    [
        ("/robots/sim1%20", "robot_unknown"),
        ("/robots/%0Asim1", "robot_unknown"),
        ("/users/ann%20", "record_missing"),
        ("/grants/ann/sim1%20", "robot_unknown"),
    ],
)
def test_name_has_one_spelling(root: Program, path: str, code: str) -> None:
    """The database would overlook a space at the end."""
    for method in ("GET", "DELETE"):
        if not path.startswith("/grants") or method == "DELETE":
            assert root.refused(method, path) == (404, code)
