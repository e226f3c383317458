"""A storage buffer that is made anew, larger, when more is asked of it."""

import moderngl

from .gpu_memory import reserved


class GrowingBuffer:
    """Keeps nothing of what was in it when it grows."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._buffer = context.buffer(reserve=4)

    @property
    def buffer(self) -> moderngl.Buffer:
        """The buffer as it is now; another one after it has grown."""
        return self._buffer

    def reserve(self, size: int, at_most: int | None = None) -> moderngl.Buffer:
        """Make room for so many bytes; where it has to grow it takes an eighth more, but `at_most` so many in all.

        Raises `MemoryError` where the graphics card has no room for it.
        """
        if size > self._buffer.size:
            self._buffer.release()
            self._buffer = self._context.buffer(reserve=4)  # to be there whatever comes
            roomy = size + size // 32 * 4
            self._buffer = reserved(self._context, roomy if at_most is None else max(size, min(roomy, at_most)))
        return self._buffer

    def bind(self, binding: int) -> None:
        self._buffer.bind_to_storage_buffer(binding)
