"""What goes wrong with a scene, in one sentence that a person can act on."""

from pathlib import Path


class SceneFormatError(ValueError):
    """A scene file that can't be read: names the file, the field and what would be right."""

    def __init__(self, path: Path | str, problem: str) -> None:
        super().__init__(f"{path}: {problem}")
        self.path = Path(path)
        self.problem = problem
