"""How many Gaussians of a scene are marked, for commands that count them."""

from collections.abc import Sequence

from gsrain_engine.scene.members import Actor, Layer


def marked(members: Sequence[Layer | Actor]) -> dict[str, int]:
    """Count what is deleted, and what is hidden but not deleted."""
    deleted = hidden = 0
    for member in members:
        marks = member.marks
        deleted += marks.deleted.size if marks.deleted is not None else 0
        if marks.hidden is not None:
            hidden += (marks.hidden if marks.deleted is None else marks.hidden - marks.deleted).size
    return {"deleted": deleted, "hidden": hidden}


def marked_text(counts: dict[str, int]) -> str:
    """Say so behind a number of Gaussians; nothing where none is marked."""
    said = [f"{count:,} {kind}" for kind, count in counts.items() if count]
    return f" ({', '.join(said)})" if said else ""
