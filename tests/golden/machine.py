"""The machine that hashes were made on: elsewhere sums may round in another way."""

import platform
import sys
from importlib import metadata

from gsrain_engine.render.renderer import processor_name

PACKAGES = (
    "numpy", "numba", "llvmlite", "scipy", "pillow", "moderngl", "av", "openexr", "opencv-contrib-python-headless",
)  # fmt: skip


def machine() -> dict[str, str]:
    """Return names of the processor and the OpenGL driver, and versions of what computes."""
    versions = {name: _version(name) for name in PACKAGES}
    return {
        "cpu": processor_name(),
        "opengl": _driver(),
        "python": platform.python_version(),
        "system": sys.platform,
    } | versions


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "absent"


def _driver() -> str:
    """Name the renderer and the version of OpenGL without a window."""
    import moderngl

    try:
        with moderngl.create_context(standalone=True, backend="egl") as context:  # pyright: ignore[reportCallIssue]
            return f"{context.info['GL_RENDERER']}, {context.info['GL_VERSION']}"
    except Exception as error:  # whatever a driver does: it is absent then
        return f"absent ({type(error).__name__})"
