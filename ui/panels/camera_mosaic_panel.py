"""The Rig cameras panel: what each camera of the ego vehicle sees now, side by side."""

from imgui_bundle import ImVec2, imgui

from gsrain_engine.scene.scene import RigCamera
from gsrain_engine.session.drive.mosaic import mosaic_rows
from gsrain_engine.session.session import Session

from ..widgets.colors import BACKGROUND, OUTLINE, color

_GAP = 3.0


def camera_mosaic_panel(session: Session) -> None:
    """Draw the panel; pictures are only drawn while it is to be seen."""
    mosaic, scene = session.drives.mosaic, session.scene
    if scene.ego is None or not scene.rigs:
        imgui.text_wrapped("This scene has no ego vehicle with cameras.")
        return
    if len(scene.rigs) > 1:
        names = list(scene.rigs)
        present = names.index(mosaic.rig) if mosaic.rig in names else 0
        imgui.set_next_item_width(-1)
        changed, at = imgui.combo("##rig", present, names)
        imgui.set_item_tooltip("The rig whose cameras are shown, from where the ego vehicle is now.")
        if changed:
            mosaic.rig = names[at]
    rows = mosaic_rows(mosaic.cameras(scene))
    width = _width(rows)
    mosaic.want(width)
    start = imgui.get_cursor_screen_pos()
    top = start.y
    for row in rows:
        height = max(width * each.height / each.width for each in row)
        for column, camera in enumerate(row):
            _picture(session, camera, ImVec2(start.x + column * (width + _GAP), top), width)
        top += height + _GAP
    imgui.set_cursor_screen_pos(start)
    imgui.dummy(ImVec2(max(map(len, rows)) * (width + _GAP), top - start.y))


def _width(rows: list[list[RigCamera]]) -> float:
    room, most = imgui.get_content_region_avail(), max(map(len, rows))
    by_width = (room.x - (most - 1) * _GAP) / most
    tall = sum(max(each.height / each.width for each in row) for row in rows)
    by_height = (room.y - len(rows) * _GAP) / tall
    return max(min(by_width, by_height), 60.0)


def _picture(session: Session, camera: RigCamera, at: ImVec2, width: float) -> None:
    draw, em = imgui.get_window_draw_list(), imgui.get_font_size()
    end = ImVec2(at.x + width, at.y + width * camera.height / camera.width)
    picture = session.drives.mosaic.pictures.get(camera.name)
    if picture is None:
        draw.add_rect_filled(at, end, color(BACKGROUND))
    else:
        draw.add_image(imgui.ImTextureRef(picture.name), at, end)
    words = camera.name.removeprefix("CAM_").replace("_", " ").lower()
    size = imgui.calc_text_size(words)
    low = ImVec2(at.x + 3, at.y + 3)
    draw.push_clip_rect(at, end, True)
    draw.add_rect_filled(low, ImVec2(low.x + size.x + 0.5 * em, low.y + size.y), color(OUTLINE), 3.0)
    draw.add_text(ImVec2(low.x + 0.25 * em, low.y), imgui.get_color_u32((1.0, 1.0, 1.0, 0.95)), words)
    draw.pop_clip_rect()
    if imgui.is_window_hovered() and imgui.is_mouse_hovering_rect(at, end):
        size_px = f"{camera.width} x {camera.height} px"
        imgui.set_tooltip(f"{camera.name}, {size_px}, {1000 * camera.exposure_s:.3g} ms.")
