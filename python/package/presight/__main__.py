"""The command: ``python -m presight`` and the console script ``presight``."""

import os
import sys

from ._presight import _command


def main() -> int:
    """Runs the command with this process's arguments, and returns its exit status."""
    # Mesa prints an error for a missing folder of displays; this one cannot hold a socket.
    if not os.path.isabs(os.environ.get("XDG_RUNTIME_DIR", "")):
        os.environ["XDG_RUNTIME_DIR"] = "/dev/null"
    return _command(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
