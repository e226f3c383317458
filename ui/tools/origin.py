"""The tool "Set origin": where the ego vehicle starts, where the world's origin lies, how high the ground is."""

from dataclasses import dataclass
from typing import Literal, get_args

from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.session.edits.ego_origin import SENSOR_HEIGHT_M, set_ego_start, set_origin
from gsrain_engine.session.edits.level import set_ground_height
from gsrain_engine.session.session import Session
from gsrain_engine.session.view.picking import pick_point

from ..widgets.markers import draw_hint, draw_point, draw_words, is_clicked
from ..widgets.viewport import Viewport

Meaning = Literal["Ego start", "World origin", "Ground height"]

_HELP: dict[Meaning, str] = {
    "Ego start": f"The ego vehicle starts over the point, its sensors {SENSOR_HEIGHT_M} m above it. A scene that has "
    "none gets one that stands there and looks as you do.",
    "World origin": "Everything moves so that the point becomes x = y = z = 0.",
    "Ground height": "The ground is as high as the point: rain falls down to it.",
}


@dataclass(slots=True)
class OriginTool:
    """A `Tool`."""

    name: str = "Set origin"
    icon: str = icons_fontawesome_6.ICON_FA_LOCATION_CROSSHAIRS
    key: imgui.Key | None = None
    help: str = (
        "Click a point of the ground: where the ego vehicle starts, or the world's origin, or the ground's height."
    )
    meaning: Meaning = "Ego start"

    def draw(self, session: Session, viewport: Viewport) -> bool:
        ego = session.scene.ego_to_world(session.clock.time_s)
        if ego is not None:
            draw_point(viewport, ego[:3, 3])
            draw_words(viewport, ego[:3, 3], "ego")
        draw_hint(viewport, f"Click a point of the ground: {self.meaning.lower()}")
        if is_clicked(viewport):
            point = pick_point(session.scene, viewport.shot, *viewport.mouse_px)
            if point is not None and self.meaning == "Ego start":
                session.edit("Ego start", set_ego_start, point, session.navigation.heading)
            elif point is not None and self.meaning == "Ground height":
                session.edit("Ground height", set_ground_height, float(point[2]))
            elif point is not None:
                session.edit("World origin", set_origin, point)
                session.navigation.position = session.navigation.position - point
        return False

    def options(self, session: Session) -> None:
        meanings: tuple[Meaning, ...] = get_args(Meaning)
        for meaning in meanings:
            if imgui.radio_button(meaning, self.meaning == meaning):
                self.meaning = meaning
            imgui.set_item_tooltip(_HELP[meaning])
            imgui.same_line()
        imgui.new_line()
