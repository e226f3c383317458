"""Pictures that the viewport shows: their number a second, size and exactness, in words."""

from collections import deque

_OVER_S = 1.5  # time over which pictures are counted
_REST_S = 0.6  # time without another picture after which the view is at rest
_NEARLY_ALL = 0.9


class PictureRate:
    """Counts the pictures on the screen; `now_s` is any steady clock in seconds."""

    def __init__(self) -> None:
        self.size_px = 0, 0
        """Width and height of the last drawn picture."""
        self.is_exact = False
        self._shown, self._drawn = deque[float](), deque[float]()

    def note_drawing(self, now_s: float, size_px: tuple[int, int], *, is_exact: bool) -> None:
        """Count a picture that was drawn for the viewport."""
        self.size_px, self.is_exact = size_px, is_exact
        self._drawn.append(now_s)
        self.note_displayed(now_s)

    def note_displayed(self, now_s: float) -> None:
        """Count a picture on the screen that differs from the one before, drawn or warped."""
        self._shown.append(now_s)
        for times in (self._shown, self._drawn):
            while times and times[0] < now_s - _OVER_S:
                times.popleft()

    def words(self, now_s: float) -> str:
        """Describe what is on the screen, such as `7.8 pictures/s at 480 x 320` or `exact, 960 x 640`."""
        width, height = self.size_px
        size = f"{width:,} x {height:,}"
        if not self._shown:
            return ""
        shown, drawn = _rate(self._shown), _rate(self._drawn)
        if now_s - self._shown[-1] > _REST_S or shown == 0:
            return f"exact, {size}" if self.is_exact else f"{size}, an exact one follows"
        if drawn > _NEARLY_ALL * shown:
            return f"{drawn:.2g} pictures/s at {size}"
        return f"{shown:.2g} pictures/s, {drawn:.2g} drawn at {size}"


def _rate(times_s: deque[float]) -> float:
    """Number a second of events at times; 0 if there are fewer than two."""
    return (len(times_s) - 1) / max(times_s[-1] - times_s[0], 1e-3) if len(times_s) > 1 else 0.0
