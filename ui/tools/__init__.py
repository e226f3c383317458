"""The tools of the viewport: the one table of them. Another tool is another file here and another row."""

from .box import BoxTool
from .brush import BrushTool
from .crop import CropTool
from .lasso import LassoTool
from .level import LevelTool
from .measure import MeasureTool
from .origin import OriginTool
from .pickers import ColorPickTool, FloodTool
from .polygon import PolygonTool
from .rectangle import RectangleTool
from .regions import RegionTool
from .sky_pick import SkyPickTool
from .sphere import SphereTool
from .tool import Tool
from .transform import MoveTool

TOOLS: tuple[Tool, ...] = (
    RectangleTool(),
    LassoTool(),
    PolygonTool(),
    BrushTool(),
    SphereTool(),
    BoxTool(),
    FloodTool(),
    ColorPickTool(),
    MoveTool(),
    CropTool(),
    MeasureTool(),
    LevelTool(),
    OriginTool(),
    RegionTool(),
    SkyPickTool(),
)
