"""The open capture in the picture: measured points, recorded cameras with their pictures, and the one looked from."""

from imgui_bundle import ImVec4, imgui

from gsrain_engine.scene.camera import Camera
from gsrain_engine.session.capture.frustums import Frustum, frustums, picture_grid
from gsrain_engine.session.capture.view_pictures import LARGE_PX, THUMBNAIL_PX, Wish
from gsrain_engine.session.session import Session

from ..widgets.colors import CHOSEN, OUTLINE, color
from ..widgets.viewport import Viewport
from .placed_picture import draw_placed_picture

_CAMERA = ImVec4(0.5, 0.85, 0.62, 0.9)
_HANDLE, _REACH = 4.0, 9.0
_LEFT = imgui.MouseButton_.left
_PICTURES = 24
"""So many of the nearest cameras show their pictures."""


def capture_overlay(session: Session, viewport: Viewport) -> bool:
    """Draw what is shown of the capture; returns whether the mouse is at one of its cameras."""
    captures = session.captures
    captures.viewport_px = viewport.width, viewport.height
    if captures.capture is None:
        return False
    here = captures.stands_at(session)
    if here is not None:
        _recorded_picture(session, viewport, here)
    if captures.points_texture is not None:
        low, high = viewport.corner, viewport.on_screen(viewport.width, viewport.height)
        imgui.get_window_draw_list().add_image(imgui.ImTextureRef(captures.points_texture.name), low, high)
    if here is not None:
        return False  # pyramids that are looked through would hide what is compared
    if not captures.show_frustums:
        return False
    length = captures.length_m(session.scene)
    cameras = captures.cameras(session.scene)
    found = frustums(cameras, captures.listed, length, viewport.shot.camera)
    under = _under_the_mouse(viewport, found) if viewport.hovered and session.view.tool == "" else None
    for number, each in enumerate(found):
        if number >= len(found) - _PICTURES:
            _picture(session, viewport, cameras[each.view], each.view, THUMBNAIL_PX, 1.0)
        _frustum(session, viewport, each, is_near=under is each)
    return under is not None and _act(session, under)


def _recorded_picture(session: Session, viewport: Viewport, view: int) -> None:
    captures = session.captures
    camera = captures.cameras(session.scene)[view]
    if captures.show_picture and captures.opacity > 0:
        is_there = Wish(view, LARGE_PX) in captures.textures
        if captures.pictures is not None:
            captures.pictures.want(view, LARGE_PX)
        _picture(session, viewport, camera, view, LARGE_PX if is_there else THUMBNAIL_PX, captures.opacity)
    grid = picture_grid(camera, captures.length_m(session.scene), viewport.shot.camera, (1, 1))
    if grid is not None:
        a, b, d, c = (viewport.on_screen(x, y) for x, y in grid.reshape(4, 2).tolist())
        imgui.get_window_draw_list().add_quad(a, b, c, d, color(CHOSEN), 1.5)


def _picture(session: Session, viewport: Viewport, camera: Camera, view: int, width: int, opacity: float) -> None:
    """Draw a recorded picture where its camera saw it; in cells, since draw lists know no perspective."""
    captures = session.captures
    if captures.pictures is None:
        return
    captures.pictures.want(view, width)
    texture = captures.textures.get(Wish(view, width))
    cells = (4, 3) if width == THUMBNAIL_PX else (8, 6)
    grid = picture_grid(camera, captures.length_m(session.scene), viewport.shot.camera, cells)
    if texture is not None and grid is not None:
        draw_placed_picture(viewport, texture.name, grid, opacity)


def _frustum(session: Session, viewport: Viewport, frustum: Frustum, *, is_near: bool) -> None:
    draw, is_chosen = imgui.get_window_draw_list(), session.captures.chosen == frustum.view
    hue = CHOSEN if is_chosen or is_near else _CAMERA
    for (x0, y0), (x1, y1) in frustum.lines_px.tolist():
        draw.add_line(viewport.on_screen(x0, y0), viewport.on_screen(x1, y1), color(hue), 2.0 if is_chosen else 1.0)
    if frustum.eye_px is not None:
        at = viewport.on_screen(*frustum.eye_px)
        draw.add_circle_filled(at, _HANDLE + 1.5 + 2 * is_near, color(OUTLINE))
        draw.add_circle_filled(at, _HANDLE + 2 * is_near, color(hue))


def _under_the_mouse(viewport: Viewport, found: list[Frustum]) -> Frustum | None:
    x, y = viewport.mouse_px
    near = [each for each in found if (at := each.eye_px) and abs(at[0] - x) <= _REACH and abs(at[1] - y) <= _REACH]
    return near[-1] if near else None


def _act(session: Session, frustum: Frustum) -> bool:
    captures = session.captures
    assert captures.capture is not None, "only a capture has cameras"
    view = captures.capture[frustum.view]
    moment = f", {view.time_s:.2f} s" if captures.has_times else ""
    imgui.set_tooltip(f"{view.name}{moment}. Click: choose it. Double click: look from there.")
    if imgui.is_mouse_double_clicked(_LEFT):
        captures.look_from(session, frustum.view)
    elif imgui.is_mouse_clicked(_LEFT):
        captures.chosen = frustum.view
    return True
