"""The engine: scenes, rain, rendering, jobs. Knows no window and imports no GUI library."""

import os

import platformdirs

# Numba reads this at its first import: compiled kernels outlive the process even where the package is read-only.
os.environ.setdefault("NUMBA_CACHE_DIR", platformdirs.user_cache_dir("gsrain", appauthor=False) + "/numba")
