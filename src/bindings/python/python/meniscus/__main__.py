"""The program ``meniscus``: ``python -m meniscus``, and the script that the wheel installs."""

from __future__ import annotations

import sys

from . import _conflict


def main() -> int:
    """Runs the command line of this process, and returns the exit code."""
    try:
        _conflict.require_own_package()
        from ._meniscus import program
    except ImportError as fault:
        print(f"meniscus: {fault}", file=sys.stderr)
        return 2
    return program(["meniscus", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
