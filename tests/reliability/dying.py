"""A process that dies right before the so-manieth of its calls that change the disk."""

import os
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path

_CHANGES = {
    "write", "writelines", "fsync", "replace", "rename", "unlink", "mkdir", "rmdir", "link", "flock", "truncate",
    "save", "copyfile", "chmod", "utime", "tofile", "close", "write_table", "save_file",
}  # fmt: skip


def run_in_child(work: Callable[[], int], dies_at: int | None, said: Path) -> tuple[int, int]:
    """Do something in a forked process; returns how it ended, as `subprocess` says it, and how many calls there were.

    0 counts without dying, None does not even count.

    What it prints goes to a file. This process must not have run any kernel: their threads don't live on in a child.
    """
    counted, tells = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(counted)
        output = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(output, 1)
        os.dup2(output, 2)
        calls = [0] if dies_at is None else _die_at(dies_at)
        code = 70
        try:
            code = work()
        finally:
            sys.setprofile(None)
            sys.stdout.flush()
            sys.stderr.flush()
            os.write(tells, str(calls[0]).encode())
            os._exit(code)
    os.close(tells)
    _, status = os.waitpid(child, 0)
    count = int(os.read(counted, 32) or b"0")
    os.close(counted)
    return os.waitstatus_to_exitcode(status), count


def _die_at(number: int) -> list[int]:
    calls = [0]

    def count(_: object, event: str, function: object) -> None:
        if event == "c_call" and getattr(function, "__name__", "") in _CHANGES:
            calls[0] += 1
            if calls[0] == number:
                os.kill(os.getpid(), signal.SIGKILL)

    threading.setprofile(count)
    sys.setprofile(count)
    return calls
