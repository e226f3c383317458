"""A capture without the pictures that can't be read: found by reading each once."""

from collections.abc import Callable
from dataclasses import replace

from .capture import Capture, CaptureError, View


def readable_pictures(capture: Capture, on_progress: Callable[[float], None] | None = None) -> Capture:
    """Leave out the views whose pictures can't be read, and name them in the capture's problems.

    Raises `CaptureError` where none is left.
    """
    kept: list[View] = []
    broken: list[str] = []
    for k, view in enumerate(capture):
        try:
            _ = view.image
        except CaptureError as error:
            broken.append(f"View {view.name} is left out: {error}.")
        else:
            kept.append(view)
        if on_progress is not None:
            on_progress((k + 1) / len(capture))
    if not kept:
        raise CaptureError(f"{capture.name}: not one picture can be read ({broken[0]})" if broken else capture.name)
    return replace(capture, views=tuple(kept), problems=(*capture.problems, *broken)) if broken else capture
