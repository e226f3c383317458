"""One picture of a scene in the rain: for those who want an array, and no clip."""

from gsrain_engine.rain.rain import Rain
from gsrain_engine.rain.rainfall import OVERCAST, Rainfall
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.scene import Scene

from .frame import Frame
from .renderer import Renderer
from .sequence import FrameSequence
from .sky_color import Sky


def render_still(
    renderer: Renderer, scene: Scene, rain: Rain, camera: Camera, time_s: float = 0.0, *, with_depth: bool = False
) -> Frame:
    """Draw a scene in its rain from a camera that stands in the world (metres, z up), at a moment of scene and rain.

    The scene's wet colours come with the rain's wetness; depth (m) is the scene's, without rain. It is the frame that
    `gsrain render` writes. Each call looks around for the colour of the sky, which is that of the drops (paper, eq. 3):
    for many frames keep one `FrameSequence`. Raises ValueError for a calibration that the rain names and there is not.
    """
    rainfall = Rainfall.start(rain)
    sequence = FrameSequence(scene, rainfall, camera, camera.width, camera.height, start_s=time_s)
    sky = sequence.sky(renderer) if rainfall.can_rain else Sky(OVERCAST, found=False)  # without drops nobody asks
    return sequence.frame(renderer, 0, sky, with_depth=with_depth)
