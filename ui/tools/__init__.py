"""Tools of the viewport. A new one needs a file here and a row in the table."""

from .base import Tool
from .rain import RegionTool, SkyPickTool
from .select_screen import BrushTool, ColorPickTool, FloodTool, LassoTool, PolygonTool, RectangleTool
from .select_volume import BoxTool, CropTool, SphereTool
from .transform import LevelTool, MeasureTool, MoveTool, OriginTool

TOOLS: tuple[type[Tool], ...] = (
    RectangleTool, LassoTool, PolygonTool, BrushTool, SphereTool, BoxTool, FloodTool, ColorPickTool, MoveTool, CropTool,
    MeasureTool, LevelTool, OriginTool, RegionTool, SkyPickTool,
)  # fmt: skip
