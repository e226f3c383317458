"""Words out of files in figures: short enough to leave room for the curves, and nothing in them is a formula."""

from functools import cache

from .printable import printable

_MISSING = "□"
"""In the place of a sign that the font lacks."""


def figure_words(words: object, longest: int = 48) -> str:
    """Return words as Matplotlib writes them as they are.

    The middle of long ones is left out, `$` begins no formula, an underscore in front hides no curve from the legend,
    and a sign that the font lacks becomes a box.
    """
    line = printable(words, longest)
    if not line.isascii():
        line = "".join(sign if _has_glyph(sign) else _MISSING for sign in line)
    line = line.replace("$", r"\$")
    return f" {line}" if line.startswith("_") else line


@cache
def _has_glyph(sign: str) -> bool:
    from matplotlib.font_manager import findfont, get_font  # loads slowly, and most names are ASCII

    return get_font(findfont("DejaVu Sans")).get_char_index(ord(sign)) != 0
