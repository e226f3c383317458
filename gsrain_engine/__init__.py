"""The engine: scenes, rain, rendering, jobs. Knows no window and imports no GUI library."""

from .compile_cache import use_kernel_cache, wait_briefly

use_kernel_cache()

wait_briefly()
