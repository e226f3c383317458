"""Handles in the picture that a frame of the world is moved, turned or scaled with: ImGuizmo, one value a drag."""

from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from imgui_bundle import imgui, imguizmo
from jaxtyping import Float64

from gsrain_engine.session.view.gizmo_matrices import (
    Handle,
    column_major,
    dragged_by,
    from_column_major,
    opengl_projection,
    opengl_view,
)

from .viewport import Viewport

_GIZMO = imguizmo.im_guizmo
_OPERATIONS = {
    "translate": _GIZMO.OPERATION.translate,
    "rotate": _GIZMO.OPERATION.rotate,
    "scale": _GIZMO.OPERATION.scale,
}
_SIZE = 0.17
"""Of the picture."""
_STEPS = {"translate": 0.5, "rotate": 15.0, "scale": 0.1}
"""Metres, degrees and factors that Ctrl snaps to."""


@dataclass(slots=True)
class Gizmo:
    """One gizmo; `name` tells it from others in the same picture."""

    name: str
    _start: Float64[np.ndarray, "4 4"] | None = None
    _present: Float64[np.ndarray, "4 4"] | None = None

    @property
    def is_held(self) -> bool:
        """Whether one of its handles is being dragged."""
        return self._start is not None

    def let_go(self) -> None:
        self._start = self._present = None

    def draw(
        self, viewport: Viewport, frame: Float64[np.ndarray, "4 4"], handle: Handle
    ) -> tuple[Float64[np.ndarray, "4 4"] | None, bool]:
        """Draw it in a frame of the world (metres) and act on the mouse, each frame.

        Returns the similarity of the world that the drag has come to, None while nothing is dragged; and whether the
        left button is the gizmo's own now. The frame that is drawn follows the hand: `frame` is where a drag begins.
        """
        start = self._start if self._start is not None else frame
        present = self._present if self._present is not None else frame
        _GIZMO.push_id(self.name)
        _GIZMO.begin_frame()
        _GIZMO.set_orthographic(False)
        _GIZMO.set_gizmo_size_clip_space(_SIZE)
        _GIZMO.allow_axis_flip(False)
        _GIZMO.set_drawlist()
        _GIZMO.set_rect(viewport.corner.x, viewport.corner.y, viewport.width, viewport.height)
        matrix = _GIZMO.Matrix16(column_major(present))
        snap = _GIZMO.Matrix3([_STEPS[handle]] * 3) if imgui.get_io().key_ctrl else None
        camera = viewport.shot.camera
        with _nothing_in_the_way(viewport):
            _GIZMO.manipulate(
                _GIZMO.Matrix16(opengl_view(camera)),
                _GIZMO.Matrix16(opengl_projection(camera)),
                _OPERATIONS[handle],
                _GIZMO.MODE.world if handle != "scale" else _GIZMO.MODE.local,
                matrix,
                None,
                snap,
            )
        held, hovered = _GIZMO.is_using(), _GIZMO.is_over()
        _GIZMO.pop_id()
        if not held:
            self.let_go()
            return None, hovered
        self._start, self._present = start, from_column_major(matrix.values)
        return dragged_by(handle, start, self._present), True


@contextmanager
def _nothing_in_the_way(viewport: Viewport) -> Generator[None]:
    """Hide the picture's own button: ImGuizmo takes no click where another item is under the mouse."""
    context = imgui.get_current_context()
    hovered, before, active = context.hovered_id, context.hovered_id_previous_frame, context.active_id
    if viewport.hovered or viewport.active:
        context.hovered_id = context.hovered_id_previous_frame = context.active_id = 0
    yield
    context.hovered_id, context.hovered_id_previous_frame, context.active_id = hovered, before, active
