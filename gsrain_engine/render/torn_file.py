"""A file for an encoder that does not survive a full disk: it never hears of errors, who drives it does."""

from pathlib import Path


class TornFile:
    """Takes bytes until the disk refuses some; from then on it pretends, and keeps the error.

    FFmpeg's fragmented MP4 ends the process when it is closed after an error of its output.
    """

    def __init__(self, path: Path) -> None:
        """Open a file for writing, without a buffer: what is written survives the process."""
        self._path, self._file = path, path.open("wb", buffering=0)
        self._position = self._end = 0
        self.error: OSError | None = None

    def check(self) -> None:
        """Raise the error that there was, if there was one."""
        if self.error is not None:
            raise self.error

    def write(self, data: bytes) -> int:
        if self.error is None:
            try:
                self._file.seek(self._position)
                rest = memoryview(data)
                while rest:
                    rest = rest[self._file.write(rest) :]
            except OSError as error:
                self.error = OSError(error.errno, error.strerror, str(self._path))
        self._position += len(data)
        self._end = max(self._end, self._position)
        return len(data)

    def seek(self, offset: int, whence: int = 0) -> int:
        """Go to a position: from the start, from here, or from the end."""
        self._position = offset + (0, self._position, self._end)[whence]
        return self._position

    def tell(self) -> int:
        return self._position

    def close(self) -> None:
        self._file.close()
