"""The engine: scenes, rain, rendering, jobs. Knows no window and imports no GUI library."""

from .kernel_cache import use_kernel_cache
from .openmp import wait_briefly

use_kernel_cache()
wait_briefly()
