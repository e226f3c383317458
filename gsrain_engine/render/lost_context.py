"""Contexts that are lost: a driver that restarts, or a card that goes away, takes all that is on the card along."""

import ctypes
import time
from collections.abc import Callable

import moderngl

_QUESTIONS = (("GL_KHR_robustness", "KHR"), ("GL_ARB_robustness", "ARB"))


class LostContextError(OSError):
    """What was on the graphics card is gone; nothing more can be drawn in this context."""

    def __init__(self) -> None:
        super().__init__("the graphics driver has restarted, or the card is gone: what was being drawn is lost")


class ContextWatch:
    """Remembers that a context is lost: some drivers say so only once."""

    def __init__(self, ask: Callable[[], int]) -> None:
        """`ask` is the driver's glGetGraphicsResetStatus: 0 while all is well, or again."""
        self.ask = ask
        self._is_lost = False

    def is_lost(self) -> bool:
        """Whether the context was ever lost. Asks the driver, which takes about a microsecond."""
        self._is_lost = self._is_lost or self.ask() != 0
        return self._is_lost

    def wait_for_driver(self, most_s: float) -> None:
        """Wait until the driver has restarted: it says so until then."""
        until = time.monotonic() + most_s
        while self.ask() and time.monotonic() < until:
            time.sleep(0.05)


def watch(context: moderngl.Context, address_of: Callable[[str], int | None]) -> None:
    """Let a context be asked whether it is lost; `address_of` finds entry points of OpenGL by name.

    Drivers know only of contexts that were made to tell of resets.
    """
    extensions = context.extensions
    endings = ["", *(ending for name, ending in _QUESTIONS if name in extensions)]
    for ending in endings if context.version_code >= 450 else endings[1:]:  # an address alone does not prove anything
        if address := address_of(f"glGetGraphicsResetStatus{ending}"):
            context.extra = ContextWatch(_question(address))
            return


def watch_of(context: moderngl.Context) -> ContextWatch | None:
    """Who knows whether a context is lost; None where its driver does not tell."""
    return context.extra


def check_context(context: moderngl.Context) -> None:
    """Raise `LostContextError` where what was drawn or read may be nothing at all."""
    watcher = watch_of(context)
    if watcher is not None and watcher.is_lost():
        raise LostContextError


def _question(address: int) -> Callable[[], int]:
    """Make glGetGraphicsResetStatus, which is at an address, a function of Python."""
    return ctypes.CFUNCTYPE(ctypes.c_uint)(address)
