"""What runs a sweep: versions of the program and of what it computes with."""

from importlib import metadata

_COMPUTED_WITH = ("numpy", "onnxruntime", "scipy", "shapely")


def program_version() -> str:
    return metadata.version("gsrain")


def software() -> dict[str, str]:
    """Return versions by package, of those that are installed: other ones may round in another way."""
    found = {"gsrain": program_version()}
    for name in _COMPUTED_WITH:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found
