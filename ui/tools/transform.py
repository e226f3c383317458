"""The tool "Move": a gizmo that moves, turns and scales what is selected, or the current layer or actor."""

from dataclasses import dataclass, field

import numpy as np
from imgui_bundle import icons_fontawesome_6, imgui
from jaxtyping import Float64

from gsrain_engine.scene.scene import Scene
from gsrain_engine.session.edits.marking import selected_count
from gsrain_engine.session.edits.moving import move_member, move_selected, moving, pivot
from gsrain_engine.session.session import Session
from gsrain_engine.session.view.gizmo_matrices import Handle, standing_at

from ..widgets.gizmo import Gizmo
from ..widgets.markers import draw_hint
from ..widgets.viewport import Viewport

_VERBS: dict[Handle, tuple[str, str]] = {
    "translate": ("Move", "Drag an arrow or a square; Ctrl snaps to half a metre."),
    "rotate": ("Turn", "Drag a ring; Ctrl snaps to 15 degrees."),
    "scale": ("Scale", "Drag a handle: all three axes scale alike; Ctrl snaps to tenths."),
}


@dataclass(slots=True)
class _Drag:
    """What is being dragged, and by how much."""

    scene: Scene
    key: str | None
    time_s: float
    delta: Float64[np.ndarray, "4 4"]


@dataclass(slots=True)
class MoveTool:
    """A `Tool`."""

    name: str = "Move"
    icon: str = icons_fontawesome_6.ICON_FA_UP_DOWN_LEFT_RIGHT
    key: imgui.Key | None = imgui.Key.t
    help: str = "Move, turn or scale what is selected, else what is picked in Layers. Ctrl snaps, Esc takes it back."
    handle: Handle = "translate"
    _gizmo: Gizmo = field(default_factory=lambda: Gizmo("move"))
    _drag: _Drag | None = None
    _frame: int = 0

    def draw(self, session: Session, viewport: Viewport) -> bool:
        """Draw the gizmo where the thing is and show the thing where the gizmo has it; one drag is one step."""
        scene = session.scene
        was_put_away, self._frame = self._frame < imgui.get_frame_count() - 1, imgui.get_frame_count()
        if was_put_away:
            self._gizmo.let_go()
        if self._drag is not None and (was_put_away or self._drag.scene is not scene):
            self._drag = None  # taken back by Esc, or the document went on without it
        key, time_s = _target(session), session.clock.time_s
        middle = pivot(scene, key, time_s) if key != "" else None
        if middle is None:
            draw_hint(viewport, "Select something, or pick an unlocked layer or actor in Layers")
            return False
        delta, is_taken = self._gizmo.draw(viewport, standing_at(middle), self.handle)
        if delta is not None:
            self._drag = _Drag(scene, key, time_s, delta)
            session.preview = moving(scene, key, delta, time_s)
        elif self._drag is not None:
            self._finish(session, self._drag)
        return is_taken

    def options(self, session: Session) -> None:
        for handle, (verb, help_text) in _VERBS.items():
            if imgui.radio_button(f"{verb}##handle", self.handle == handle):
                self.handle = handle
            imgui.set_item_tooltip(help_text)
            imgui.same_line()
        key = _target(session)
        name = f"{selected_count(session.scene):,} selected" if key is None else key.partition("/")[2] or "nothing"
        imgui.text_disabled(name)
        imgui.set_item_tooltip("What the gizmo acts on: the selection, else the layer or actor picked in Layers.")

    def _finish(self, session: Session, drag: _Drag) -> None:
        self._drag, verb = None, _VERBS[self.handle][0]
        if np.array_equal(drag.delta, np.eye(4)):
            return
        if drag.key is None:
            session.edit(f"{verb} the selection", move_selected, drag.delta, drag.time_s)
        else:
            name = drag.key.partition("/")[2]
            session.edit(f"{verb} {name}", move_member, drag.key, drag.delta)


def _target(session: Session) -> str | None:
    """None for the selection, the key of a member, "" for nothing."""
    if selected_count(session.scene):
        return None
    chosen = next((each for each in session.scene.members if each.key == session.view.member), None)
    return chosen.key if chosen is not None and chosen.visible and not chosen.locked else ""
