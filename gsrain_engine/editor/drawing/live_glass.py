"""Water on the glass in front of the viewport's camera and of the cameras of a rig."""

from collections.abc import Hashable

import moderngl
import numpy as np
from jaxtyping import Float64

from ...rain.frame import SkyLight
from ...rain.simulation import RainSimulation
from ...render.camera_optics import CameraOptics, ego_motion
from ...render.draw import RenderView
from ...render.renderer import Color, Renderer, RenderMode
from ...scene.scene import Scene
from ...water.refraction import GlassView


def has_glass(rainfall: RainSimulation, mode: RenderMode = "splats") -> bool:
    """Return whether pictures of a render mode are behind glass, wet or dry."""
    return mode == "splats" and rainfall.rain.glass != "none"


class LiveGlass:
    """Draws pictures through wet glass, without the sensor. Lives in the OpenGL context of its view.

    Drops on the glass of each camera go on from frame to frame; their past is replayed when time goes back, or after
    a change of the rain.
    """

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._optics = CameraOptics()
        self._textures: dict[Hashable, moderngl.Texture] = {}

    def before(
        self,
        renderer: Renderer,
        scene: Scene,
        rainfall: RainSimulation,
        sky: SkyLight,
        view: RenderView,
        camera: Hashable,
        camera_to_vehicle: Float64[np.ndarray, "3 3"] | None = None,
    ) -> GlassView | None:
        """Prepare the glass in front of a camera, before its picture is drawn by the same renderer.

        A camera of the ego vehicle's rig has the vehicle's motion as its past; any other has had the view's velocity.
        None if there is no glass.
        """
        if not has_glass(rainfall):
            return None
        past = None if camera_to_vehicle is None else ego_motion(scene, view).motion
        return self._optics.glass_view(
            renderer, scene, rainfall, sky, view, camera=camera, past=past, camera_to_vehicle=camera_to_vehicle
        )

    def texture(self, glass: GlassView, renderer: Renderer, background: Color, camera: Hashable) -> moderngl.Texture:
        """Texture of the renderer's last picture through a camera's glass."""
        pixels = glass.picture(renderer.read_uint8(background))
        height, width = pixels.shape[:2]
        texture = self._textures.get(camera)
        if texture is None or texture.size != (width, height):
            if texture is not None:
                texture.release()
            texture = self._textures[camera] = self._context.texture((width, height), 3, alignment=1)
            texture.filter = moderngl.NEAREST, moderngl.NEAREST
        texture.write(pixels, alignment=1)
        return texture
