"""Words out of files in sentences for people: no sign in them steers a terminal, and none goes on for pages."""

_LONGEST = 600


def printable(words: object, longest: int = _LONGEST) -> str:
    """Return words as one line: signs that can't be printed as their escapes, and the middle of long ones left out."""
    line = " ".join(str(words).split())
    if not line.isprintable():
        line = "".join(sign if sign.isprintable() else repr(sign)[1:-1] for sign in line)
    return line if len(line) <= longest else f"{line[: longest // 2]} ... {line[-longest // 2 :]}"
