"""Warp of a picture to a camera that has moved on since it was drawn, on a mesh of its relief."""

import moderngl
import numpy as np

from ...scene.camera import Camera
from ..relief import MAX_MOVERS, Relief
from .buffers import sized_target
from .shaders import load_program

_MOTIONS = MAX_MOVERS + 1  # and that of what stands still
_MAX_TURN = np.cos(np.radians(40.0))  # beyond it, little of the picture is in view
_MAX_TIME_S = 1.0
_NEAREST_M = 0.01
_FINER = 1.5  # ratio of the pixels across a warped picture to those of the picture, which the display enlarges
_MAX_MOVE = 1.0  # by which the camera may move, in distances of what is before it


def can_warp(relief: Relief, camera: Camera, time_s: float) -> bool:
    """Return whether a picture is outdated, but not so far that a warped one would show little that is true."""
    before, now = relief.camera.world_to_camera, camera.world_to_camera
    if not (relief.camera.is_pinhole and camera.is_pinhole):
        return False
    if np.array_equal(before, now) and (time_s == relief.time_s or not relief.movers):
        return False
    moved = np.linalg.norm(camera.position - relief.camera.position) * np.median(relief.inverse_m)
    is_late = abs(time_s - relief.time_s) > _MAX_TIME_S
    return bool(not is_late and moved < _MAX_MOVE and before[2, :3] @ now[2, :3] > _MAX_TURN)


class PictureWarp:
    """Draws warped pictures into a texture of its own, first row on top, in the OpenGL context that is current."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._program: moderngl.Program | None = None
        self._mesh: tuple[tuple[int, ...], moderngl.Buffer, moderngl.VertexArray] | None = None
        self._relief: Relief | None = None
        self._target: moderngl.Framebuffer | None = None

    def show(self, picture: moderngl.Texture, relief: Relief, camera: Camera, time_s: float) -> moderngl.Texture:
        """Draw a picture as a camera sees it, with its road users where they are at a time.

        The texture may be one of another context that shares it.
        """
        share = min(1.0, _FINER * picture.width / camera.width)
        camera = camera.resized(round(share * camera.width), round(share * camera.height))
        own = self._context.external_texture(picture.glo, picture.size, picture.components, 0, picture.dtype)
        vertices = self._mesh_of(relief)
        target = self._target = sized_target(self._context, self._target, (camera.width, camera.height))
        program, drawn = vertices.program, relief.camera
        rows, columns = relief.inverse_m.shape
        program["nodes"], program["step_px"] = (columns + 2, rows + 2), float(relief.step)
        program["size_px"], program["canvas_px"] = (drawn.width, drawn.height), (camera.width, camera.height)
        program["drawn_lens"] = drawn.fx, drawn.fy, drawn.cx, drawn.cy
        program["lens"] = camera.fx, camera.fy, camera.cx, camera.cy
        program["nearest_m"] = max(_NEAREST_M, 0.5 * camera.plane_m)
        to_camera = np.zeros((_MOTIONS, 4, 4), np.float32)
        moved = camera.world_to_camera @ relief.motions(time_s) @ drawn.camera_to_world
        to_camera[: len(moved)] = moved.transpose(0, 2, 1)  # column-major
        program["to_camera"].write(to_camera)  # pyright: ignore[reportAttributeAccessIssue]
        window = self._context.detect_framebuffer()
        target.use()
        target.clear(0.0, 0.0, 0.0, 1.0)
        own.use(0)
        self._context.enable(moderngl.DEPTH_TEST)
        vertices.render(moderngl.TRIANGLES)
        self._context.disable(moderngl.DEPTH_TEST)
        window.use()
        return target.color_attachments[0]  # pyright: ignore[reportReturnType]

    def _mesh_of(self, relief: Relief) -> moderngl.VertexArray:
        if self._program is None:
            self._program = load_program(self._context, "warp.vert", "warp.frag", switches={"MOTIONS": _MOTIONS})
            self._program["picture"] = 0
        shape = relief.inverse_m.shape
        if self._mesh is None or self._mesh[0] != shape:
            if self._mesh is not None:
                self._mesh[1].release()
                self._mesh[2].release()
            rows, columns = shape[0] + 2, shape[1] + 2
            first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).reshape(-1, 1)
            quads = (first + [0, 1, columns, 1, columns + 1, columns]).astype(np.uint32)
            heights = self._context.buffer(reserve=8 * rows * columns, dynamic=True)
            content = [(heights, "2f4", "corner")]
            self._mesh = shape, heights, self._context.vertex_array(self._program, content, self._context.buffer(quads))
            self._relief = None
        if relief is not self._relief:
            corners = np.stack([relief.inverse_m, relief.owners], axis=-1, dtype=np.float32)
            self._mesh[1].write(np.pad(corners, ((1, 1), (1, 1), (0, 0)), mode="edge"))
            self._relief = relief
        return self._mesh[2]
