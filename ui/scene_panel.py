"""The Scene panel: layers, actors, how the scene lies in the world."""

from imgui_bundle import imgui

from gsrain_engine.render.gpu_arrays import Harmonics
from gsrain_engine.session.session import Session

from .fields import plain_label

_STORAGES: dict[Harmonics, str] = {"single": "32 bits", "half": "16 bits", "byte": "8 bits"}


def scene_panel(session: Session) -> None:
    """Draw the panel."""
    scene = session.scene
    imgui.text(f"{scene.name}: {scene.gaussian_count:,} Gaussians")
    flags = imgui.TableFlags_.row_bg | imgui.TableFlags_.sizing_stretch_prop
    if imgui.begin_table("members", 3, flags):
        for layer in scene.layers:
            _member(session, layer.key, layer.name, layer.kind, len(layer.gaussians), layer.visible)
        for actor in scene.actors:
            _member(session, actor.key, actor.id, f"actor, {actor.class_name}", len(actor.gaussians), actor.visible)
        imgui.end_table()
    imgui.separator_text("View")
    view = session.view
    plain_label("Background", "Shown where the scene has nothing.")
    _, color = imgui.color_edit3("##background", list(view.background))
    view.background = (color[0], color[1], color[2])
    plain_label("Display gain (EV)", "Brightens or darkens the display only, not the scene.")
    _, view.gain_ev = imgui.slider_float("##gain", view.gain_ev, -3, 3, "%.1f")
    plain_label("Resolution", "Draw fewer pixels while tuning; the rain keeps its drops.")
    changed, index = imgui.combo("##resolution", view.shrink - 1, ["100 %", "50 %", "33 %"])
    if changed:
        view.shrink = index + 1
    plain_label("Colors on the GPU", "Fewer bits take less memory and, of large scenes, less time a frame.")
    imgui.begin_disabled(session.backend != "opengl")
    storages = list(_STORAGES)
    changed, index = imgui.combo("##harmonics", storages.index(view.harmonics), list(_STORAGES.values()))
    if changed:
        view.harmonics = storages[index]
    imgui.end_disabled()
    plain_label("While moving", "Hold this frame time while the camera moves by drawing less; exact once it rests.")
    _, session.budget.enabled = imgui.checkbox("##budget", session.budget.enabled)
    imgui.same_line()
    imgui.set_next_item_width(-1)
    imgui.begin_disabled(not session.budget.enabled)
    budget = session.budget
    _, budget.target_ms = imgui.slider_float("##target_ms", budget.target_ms, 10, 200, "%.0f ms a frame")
    imgui.end_disabled()
    plain_label("Field of view", "Vertical, in degrees.")
    _, session.navigation.vertical_fov_deg = imgui.slider_float(
        "##fov", session.navigation.vertical_fov_deg, 15, 110, "%.0f"
    )


def _member(session: Session, key: str, name: str, kind: str, count: int, visible: bool) -> None:
    imgui.table_next_row()
    imgui.table_next_column()
    changed, shown = imgui.checkbox(f"{name}##{kind}", visible)
    imgui.set_item_tooltip("Show or hide.")
    if changed:
        session.show_member(key, shown)
    imgui.table_next_column()
    imgui.text_disabled(kind)
    imgui.table_next_column()
    imgui.text(f"{count:,}")
