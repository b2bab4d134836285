"""The helper's start stands before each tunnel: it must be quick, and say nothing on the connection."""

from __future__ import annotations

import subprocess
import sys

from robotether_agent.net.fd_passing import HELPER


def test_it_imports_next_to_nothing():
    """Python's own start is all that it takes."""
    code = f"import sys, runpy; before = set(sys.modules); runpy.run_path({str(HELPER)!r}); "
    code += "print(*sorted(set(sys.modules) - before))"
    imported = subprocess.run(
        [sys.executable, "-I", "-S", "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    plain = "import sys, runpy; before = set(sys.modules); runpy.run_path('/dev/null'); "
    plain += "print(*sorted(set(sys.modules) - before))"
    without = subprocess.run(
        [sys.executable, "-I", "-S", "-c", plain], capture_output=True, text=True, check=True
    ).stdout.split()
    assert set(imported) - set(without) <= {"_socket"}
