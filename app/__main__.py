"""Entry point of `gsrain` and `python -m app`."""

import os
import signal
import sys
from typing import NoReturn

_MIN_ADDRESS_SPACE_BYTES = 2 << 30  # below, libraries hang or crash while they load
_BAD_INPUT, _INTERRUPTED = 2, 130


def main() -> None:
    """Run the program. Ctrl-C also ends it by one line while its libraries load."""
    is_ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if is_ours:
        signal.signal(signal.SIGINT, _stop)  # an exception could be lost in a library that loads
    _check_address_space()
    from .main import run

    try:
        if is_ours:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        code = run(sys.argv[1:])
    except KeyboardInterrupt:
        _stop()
    sys.exit(code)


def _stop(*_: object) -> NoReturn:
    _end("stopped", _INTERRUPTED)


def _end(reason: str, code: int) -> NoReturn:
    """End the process at once: the console, and what else would report it, may not be loaded."""
    os.write(2, f"gsrain: {reason}\n".encode())
    os._exit(code)


def _check_address_space() -> None:
    if sys.platform == "win32":
        return
    import resource

    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY and limit < _MIN_ADDRESS_SPACE_BYTES:
        found, needed = limit >> 20, _MIN_ADDRESS_SPACE_BYTES >> 20
        _end(f"the address space is limited to {found} MiB (ulimit -v), at least {needed} MiB are needed", _BAD_INPUT)


if __name__ == "__main__":
    main()
