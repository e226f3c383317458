"""A camera that stands in the world, and when it looks."""

from dataclasses import dataclass, replace

from gsrain_engine.datasets.geometry.scaled_camera import scaled_camera
from gsrain_engine.scene.camera import Camera


@dataclass(frozen=True, slots=True, eq=False)
class PlacedCamera:
    """From where, and when, a view is taken: actors stand where they are at that time."""

    name: str
    camera: Camera
    """In the world (metres, z up)."""
    time_s: float = 0.0
    sensor: str = ""
    """Which camera of a rig it is; empty where there is only one."""

    def at_width(self, width_px: int | None) -> "PlacedCamera":
        """Show the same in a picture so wide, of the nearest whole height; None changes nothing."""
        if width_px is None or width_px == self.camera.width:
            return self
        height = max(round(self.camera.height * width_px / self.camera.width), 1)
        return replace(self, camera=scaled_camera(self.camera, width_px, height))
