"""Undo and redo: a list of documents and a cursor. Documents are values, so a step costs a reference."""

from dataclasses import dataclass, field

from .document import Document


@dataclass(slots=True)
class _Step:
    label: str
    document: Document
    gesture: str | None = None
    """What is being dragged; further changes by the same gesture belong to the same step."""


@dataclass(slots=True)
class History:
    """Steps that led here; the cursor stands on the present one."""

    _steps: list[_Step] = field(default_factory=list[_Step])
    _cursor: int = 0

    @classmethod
    def beginning_with(cls, document: Document) -> "History":
        """Start with a document that was opened."""
        return cls([_Step("Open", document)])

    @property
    def labels(self) -> list[str]:
        """What each step did, the oldest first."""
        return [step.label for step in self._steps]

    @property
    def cursor(self) -> int:
        return self._cursor

    @property
    def present(self) -> Document:
        return self._steps[self._cursor].document

    @property
    def previous(self) -> Document:
        """The document before the last step; at the beginning the present one."""
        return self._steps[max(0, self._cursor - 1)].document

    @property
    def gesture(self) -> str | None:
        """The gesture that the present step belongs to, while it goes on."""
        return self._steps[self._cursor].gesture

    @property
    def undo_label(self) -> str | None:
        """What undo would take back; None at the beginning."""
        return self._steps[self._cursor].label if self._cursor > 0 else None

    @property
    def redo_label(self) -> str | None:
        """What redo would bring back; None at the end."""
        return self._steps[self._cursor + 1].label if self._cursor + 1 < len(self._steps) else None

    def record(self, label: str, document: Document, gesture: str | None = None) -> None:
        """Go to a new document; what could be redone is gone. A gesture that goes on replaces its own last step."""
        step = self._steps[self._cursor]
        if gesture is not None and step.gesture == gesture:
            step.document = document
        else:
            del self._steps[self._cursor + 1 :]
            self._steps.append(_Step(label, document, gesture))
            self._cursor += 1

    def end_gesture(self) -> None:
        """Let go: the next change is a step of its own."""
        self._steps[self._cursor].gesture = None

    def undo(self) -> Document:
        """Step back; at the beginning nothing happens."""
        self._cursor = max(0, self._cursor - 1)
        return self.present

    def go_to(self, step: int) -> Document:
        self._cursor = min(max(step, 0), len(self._steps) - 1)
        return self.present

    def redo(self) -> Document:
        """Step forward; at the end nothing happens."""
        self._cursor = min(len(self._steps) - 1, self._cursor + 1)
        return self.present
