"""Entry point of `gsrain` and `python -m app`."""

import sys

from .main import run


def main() -> None:
    """Run the command line and leave with its exit code."""
    sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
