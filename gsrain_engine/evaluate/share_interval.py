"""How far a share that was counted, such as collisions of runs, may be from the true one."""

_Z95 = 1.959963984540054
"""Of the normal law: 95 % lie within so many standard deviations."""


def share_interval(hits: int, of: int) -> tuple[float, float]:
    """Return the ends of the 95 % confidence interval of hits / of (Wilson 1927); 0..1 where nothing was counted.

    Holds for independent trials; it is right for few of them, and for none or all that hit.
    """
    if not of:
        return 0.0, 1.0
    z2 = _Z95**2
    middle = (hits + z2 / 2) / (of + z2)
    half = _Z95 / (of + z2) * (hits * (of - hits) / of + z2 / 4) ** 0.5
    return max(0.0, middle - half), min(1.0, middle + half)
