"""What is marked among a member's Gaussians. Edits mark: the arrays stay, so a step of undo costs a few bits."""

from dataclasses import dataclass

from .mask import Mask, union


@dataclass(frozen=True, slots=True, eq=False)
class Marks:
    """Marks of one member; none where nothing is marked."""

    selected: Mask | None = None
    hidden: Mask | None = None
    deleted: Mask | None = None
    """Gone, but for undo: files never see them."""

    @property
    def left_out(self) -> Mask | None:
        """What is not drawn; the very same value each time."""
        if self.hidden is None or self.deleted is None:
            return self.deleted if self.hidden is None else self.hidden
        return union(self.hidden, self.deleted)


UNMARKED = Marks()
