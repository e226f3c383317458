"""The engine: scenes, rain, rendering, jobs. Knows no window and imports no GUI library."""

from .kernel_cache import use_kernel_cache

use_kernel_cache()
