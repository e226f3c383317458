"""The engine: scenes, rain, rendering and jobs, without a window or GUI library."""

from .compile_cache import use_kernel_cache, wait_briefly

use_kernel_cache()
wait_briefly()
