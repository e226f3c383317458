"""What goes wrong with a scene, in one sentence that a person can act on."""

from pathlib import Path

from gsrain_engine.untrusted.printable import printable


class SceneFormatError(ValueError):
    """A scene file that can't be read: names the file, the field and what would be right."""

    def __init__(self, path: Path | str, problem: str) -> None:
        super().__init__(f"{printable(path)}: {printable(problem)}")
        self.path = Path(path)
        self.problem = problem


def sentence_of(error: BaseException) -> str:
    """What an error says; what a disk says without its number, and with the file first."""
    if isinstance(error, OSError) and error.strerror is not None:
        return error.strerror if error.filename is None else f"{printable(error.filename)}: {error.strerror}"
    return str(error) or type(error).__name__
