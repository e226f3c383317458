"""Colours for numbers, and for layers."""


def layer_color(number: int) -> tuple[float, float, float]:
    return (1.0, 0.5, 0.2)
