"""Entry point of `gsrain` and `python -m app`."""

import sys

from .main import run


def main() -> None:
    sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
