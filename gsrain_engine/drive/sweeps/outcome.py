"""What came of a job."""

from msgspec import Struct

from ..rollouts.rollout import Rollout

Value = str | float | int | bool | None


class Outcome(Struct, frozen=True, kw_only=True):
    """A result, or why there is none. All but the last two fields follow from the job alone."""

    id: str
    """Of the job."""
    values: dict[str, Value] = {}
    """What was measured: columns of its row."""
    rollout: Rollout | None = None
    """Of a drive."""
    error: str | None = None
    """Why it failed, as a sentence."""
    stops: bool = False
    """Whether nothing else would come out of the other jobs either, such as on a full disk."""
    seconds: float = 0.0
    """For the log."""
    worker: str = ""
    """Who did it, for the log."""
