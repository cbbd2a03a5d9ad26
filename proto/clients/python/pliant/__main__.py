"""``python -m pliant``: the `pliant` program that this package finds, with the arguments given."""

from __future__ import annotations

import os
import sys

from .errors import LocalServerError
from .server import find_binary

if __name__ == "__main__":
    try:
        program = find_binary()
    except LocalServerError as missing:
        sys.exit(f"pliant: {missing}")
    os.execv(program, [program, *sys.argv[1:]])
