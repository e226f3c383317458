"""Words out of files in sentences for people: no sign in them steers a terminal, and none goes on for pages."""

_LONGEST = 600


def printable(words: object, longest: int = _LONGEST) -> str:
    """Return words as one line: signs that can't be printed as their escapes, and the middle of long ones left out."""
    line = escaped(" ".join(str(words).split()))
    return line if len(line) <= longest else f"{line[: longest // 2]} ... {line[-longest // 2 :]}"


def escaped(text: str) -> str:
    r"""Return a name or a line with everything in it that is no visible character or space as its escape.

    ESC becomes `\x1b`, a line break `\n`, U+202E and the other controls of direction `\u202e`, an undecodable byte
    `\udcff`. So no name steers a terminal, adds a line of its own, or is read backwards.
    """
    if text.isprintable():
        return text
    return "".join(sign if sign.isprintable() or sign in _SPACES else repr(sign)[1:-1] for sign in text)


_SPACES = "\u00a0\u2002\u2003\u2009\u202f\u3000"
"""Spaces that names are written with, which Python does not count as printable."""
