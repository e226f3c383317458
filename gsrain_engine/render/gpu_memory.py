"""Memory of the graphics card: OpenGL only says that there was none left when it is asked."""

import moderngl

_MOST_ERRORS = 8
"""Each kind is kept once until it is asked for; a context that is lost never stops telling."""


def reserved(context: moderngl.Context, size: int) -> moderngl.Buffer:
    """Make a buffer of so many bytes; raises `MemoryError` where the card has no room for it."""
    try:
        buffer = context.buffer(reserve=size)
    except moderngl.Error:
        raise MemoryError(_told(size)) from None
    try:
        check_gpu_memory(context, size)
    except MemoryError:
        buffer.release()
        raise
    return buffer


def check_gpu_memory(context: moderngl.Context, size: int) -> None:
    """Raise `MemoryError` where the driver has had no room for something of so many bytes that was just made."""
    for _ in range(_MOST_ERRORS):
        error = context.error
        if error == "GL_OUT_OF_MEMORY":
            raise MemoryError(_told(size))
        if error == "GL_NO_ERROR":
            return


def _told(size: int) -> str:
    return f"the graphics card has no room for {max(1, size >> 20)} MiB more"
