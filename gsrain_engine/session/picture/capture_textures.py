"""A capture's pictures and points on the GPU. Lives in the window's OpenGL context and on its thread."""

import moderngl
import numpy as np
from jaxtyping import UInt8

from gsrain_engine.render.shaders import load_program
from gsrain_engine.scene.camera import Camera

from ..capture.shown_points import ShownPoints
from ..capture.view_pictures import Wish
from ..session import Session
from ..view.texture import Texture
from .kept_texture import KeptTexture

_NEAR_M = 0.05
_POINT_PX = 3.0
_A_FRAME = 4
"""Pictures that are brought to the GPU in one frame."""


class CaptureTextures:
    """Follows the session's open capture."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._pictures: dict[Wish, tuple[UInt8[np.ndarray, "h w 3"], moderngl.Texture]] = {}
        self._program: moderngl.Program | None = None
        self._points: tuple[ShownPoints, moderngl.VertexArray, list[moderngl.Buffer]] | None = None
        self._target: moderngl.Framebuffer | None = None
        self._drawn: tuple[object, ...] | None = None
        self._matching = KeptTexture(context)

    def update(self, session: Session) -> None:
        """Bring new pictures to the GPU, release old ones, and tell the session. Once a frame."""
        there = {} if session.captures.pictures is None else dict(session.captures.pictures)
        for wish in [each for each, (pixels, _) in self._pictures.items() if there.get(each) is not pixels]:
            self._pictures.pop(wish)[1].release()
        for wish in [each for each in there if each not in self._pictures][:_A_FRAME]:
            pixels = there[wish]
            size = pixels.shape[1], pixels.shape[0]
            texture = self._context.texture(size, 3, np.ascontiguousarray(pixels), alignment=1)
            self._pictures[wish] = pixels, texture
        session.captures.textures = {
            wish: Texture(texture.glo, texture.width, texture.height) for wish, (_, texture) in self._pictures.items()
        }
        session.matching.texture = self._matching.show(session.matching.picture)

    def draw_points(self, session: Session, camera: Camera) -> None:
        """Draw the points as a camera of the viewport's size sees them, over nothing, and tell the session."""
        captures = session.captures
        captures.points_texture = None
        if captures.points is None or not captures.show_points:
            return
        matrix = camera.world_to_camera @ captures.to_world(session.scene)
        state = captures.points, matrix.tobytes(), camera.width, camera.height, camera.fx, camera.cx, camera.cy
        target = self._target_of(camera.width, camera.height)
        if state != self._drawn:
            self._draw(captures.points, matrix, camera, target)
            self._drawn = state
        texture = target.color_attachments[0]
        captures.points_texture = Texture(texture.glo, camera.width, camera.height)

    def _draw(self, points: ShownPoints, matrix: np.ndarray, camera: Camera, target: moderngl.Framebuffer) -> None:
        vertices, program = self._vertices_of(points)
        program["capture_to_camera"] = tuple(matrix.T.ravel().tolist())  # columns first
        program["focal_px"], program["center_px"] = (camera.fx, camera.fy), (camera.cx, camera.cy)
        program["image_size"] = (camera.width, camera.height)
        program["near_m"], program["size_px"] = _NEAR_M, _POINT_PX
        window = self._context.detect_framebuffer()
        target.use()
        target.clear(0.0, 0.0, 0.0, 0.0)
        self._context.enable(moderngl.DEPTH_TEST | moderngl.PROGRAM_POINT_SIZE)
        vertices.render(moderngl.POINTS)
        self._context.disable(moderngl.DEPTH_TEST | moderngl.PROGRAM_POINT_SIZE)
        window.use()

    def _vertices_of(self, points: ShownPoints) -> tuple[moderngl.VertexArray, moderngl.Program]:
        if self._program is None:
            self._program = load_program(self._context, "capture_points.vert", "capture_points.frag")
        if self._points is None or self._points[0] is not points:
            if self._points is not None:
                for old in (self._points[1], *self._points[2]):
                    old.release()
            buffers = [self._context.buffer(np.ascontiguousarray(each)) for each in (points.positions, points.colors)]
            content = [(buffers[0], "3f", "position"), (buffers[1], "3f1", "color")]
            self._points = points, self._context.vertex_array(self._program, content), buffers
        return self._points[1], self._program

    def _target_of(self, width: int, height: int) -> moderngl.Framebuffer:
        if self._target is None or self._target.size != (width, height):
            if self._target is not None:
                for old in (*self._target.color_attachments, self._target.depth_attachment, self._target):
                    old.release()
            color = self._context.texture((width, height), 4)
            depth = self._context.depth_renderbuffer((width, height))
            self._target, self._drawn = self._context.framebuffer([color], depth), None
        return self._target
