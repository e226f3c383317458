"""Program that reads the Gaussians, tracks and cameras of a USD stage into arrays and JSON, for `usdz.py`.

It runs in a process of its own: USD's library is written for files that one trusts, so that a damaged one may end the
process, or fill the memory. Nothing of this package is imported, so that it starts at once.

    python usd_stage.py STAGE FOLDER BYTES    (BYTES: limit of memory, 0 for none)
"""

import json
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

RESULT = "stage.json"
SPLATS = "ParticleField3DGaussianSplat"
ARRAYS = ("means", "scales", "quaternions", "opacities", "sh")
_LARGEST_DEGREE = 3
_ASSUMED_WIDTH = 1920  # of a camera without a size: USD's cameras have only the size of their film


def pxr_module(name: str) -> Any:
    """Module of OpenUSD, which is loaded only where it is used: it takes a third of a second, and has no types."""
    return import_module(f"pxr.{name}")


def read_stage(stage_file: Path, folder: Path) -> dict[str, Any]:
    """Write the arrays of each field of Gaussians to `folder` as .npy, and return all the rest as plain values.

    Matrices map columns, in the stage's units and axes. Raises `ValueError` with the reason if the stage is damaged, or
    refers to files outside its own folder.
    """
    Tf, Usd, UsdGeom = map(pxr_module, ("Tf", "Usd", "UsdGeom"))

    try:
        stage = Usd.Stage.Open(str(stage_file), Usd.Stage.LoadAll)
    except Tf.ErrorException:
        raise ValueError("its USD layer is damaged") from None
    outside = [layer.realPath for layer in stage.GetUsedLayers() if not _is_inside(layer, stage_file.parent)]
    if outside:
        raise ValueError("it refers to files outside of itself, which are not read")
    reader = _StageReader(stage, UsdGeom.XformCache(Usd.TimeCode.EarliestTime()), folder)
    for prim in Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)):
        if prim.GetTypeName() == SPLATS:
            reader.add_field(prim)
        elif prim.GetTypeName() == "Camera":
            reader.add_camera(prim)
        elif prim.GetTypeName() == "Volume" and _value(prim, "omni:nurec:isNuRecVolume"):
            reader.add_volume(prim)
    return {
        "up": str(UsdGeom.GetStageUpAxis(stage)),
        "metres_per_unit": float(UsdGeom.GetStageMetersPerUnit(stage)),
        "fields": reader.fields,
        "movers": [*reader.movers.values()],
        "cameras": reader.cameras,
        "volumes": reader.volumes,
    }


class _StageReader:
    def __init__(self, stage: Any, cache: Any, folder: Path) -> None:
        self.stage, self.cache, self.folder = stage, cache, folder
        self.fields: list[dict[str, Any]] = []
        self.movers: dict[str, dict[str, Any]] = {}
        """Moving prims by path: pose, and at which times it is visible."""
        self.cameras: list[dict[str, Any]] = []
        self.volumes: list[dict[str, Any]] = []
        """Volumes of NuRec: the file in the archive with their Gaussians, and their placement."""

    def add_field(self, prim: Any) -> None:
        if self.is_invisible(prim):
            return
        count = self.save(prim)
        index = len(self.fields)
        self.fields.append(
            {
                "index": index,
                "name": prim.GetDisplayName() or prim.GetName(),
                "role": self.inherited(prim, "gsrain:role"),
                "antialiased": bool(prim.GetCustomDataByKey("antialiased")),
                "matrix": self.matrix(prim),
                "mover": self.mover_of(prim),
                **count,
            }
        )

    def add_camera(self, prim: Any) -> None:
        mover = self.mover_of(prim)
        if mover is None:
            return
        intrinsics = _value(prim, "gsrain:intrinsics")
        if intrinsics is None or len(intrinsics) != 6:
            intrinsics = _film_intrinsics(prim)
        parent = prim.GetParent()
        self.cameras.append(
            {
                "name": prim.GetDisplayName() or prim.GetName(),
                "rig": "cameras" if str(parent.GetPath()) == mover else parent.GetDisplayName() or parent.GetName(),
                "mover": mover,
                "matrix": self.matrix(prim),
                "intrinsics": [float(value) for value in intrinsics],
                "exposure_s": float(_value(prim, "gsrain:exposureS") or 0.0),
            }
        )

    def add_volume(self, prim: Any) -> None:
        files = {str(getattr(_value(each, "filePath"), "path", "")).removeprefix("./") for each in prim.GetChildren()}
        matrix = self.matrix(prim)
        self.volumes += [{"file": file, "matrix": matrix} for file in sorted(files) if file.endswith(".nurec")]

    def save(self, prim: Any) -> dict[str, int]:
        """Write the arrays of a field; missing or short ones get the schema's defaults, longer ones are cut."""
        means = _array(prim, "positions", 3)
        n = 0 if means is None else len(means)
        degree = _value(prim, "radiance:sphericalHarmonicsDegree")
        degree = 3 if degree is None else int(degree)
        if not 0 <= degree <= 10:
            raise ValueError(f"{prim.GetPath()}: SH degree {degree} can't be read")
        stride = (degree + 1) ** 2
        kept = min(stride, (_LARGEST_DEGREE + 1) ** 2)
        sh = _array(prim, "radiance:sphericalHarmonicsCoefficients", 3)
        if sh is None or len(sh) < n * stride:
            sh, stride, kept = np.zeros((n, 3), np.float32), 1, 1
        columns = {
            "means": np.zeros((0, 3), np.float32) if means is None else means,
            "scales": _rows(_array(prim, "scales", 3), n, [1, 1, 1]),
            "quaternions": _rows(_array(prim, "orientations", 4), n, [0, 0, 0, 1])[:, [3, 0, 1, 2]],  # real part last
            "opacities": _rows(_array(prim, "opacities", 1), n, [1])[:, 0],
            "sh": np.zeros((n, 1, 3))
            if sh is None or len(sh) < n * stride
            else sh[: n * stride].reshape(n, stride, 3)[:, :kept],
        }
        for name, values in columns.items():
            file = self.folder / f"{len(self.fields)}.{name}.npy"
            np.save(file, np.ascontiguousarray(values, np.float32), allow_pickle=False)
        return {"count": n, "coefficients": int(columns["sh"].shape[1])}

    def mover_of(self, prim: Any) -> str | None:
        """Path of the outermost ancestor that moves or has the role of something that moves; None without."""
        UsdGeom = pxr_module("UsdGeom")

        found = None
        while prim and not prim.IsPseudoRoot():
            form = UsdGeom.Xformable(prim)
            if (form and form.TransformMightBeTimeVarying()) or _value(prim, "gsrain:role") in ("actor", "ego"):
                found = prim
            prim = prim.GetParent()
        if found is None:
            return None
        path = str(found.GetPath())
        if path not in self.movers:
            self.movers[path] = self.motion(found)
        return path

    def motion(self, prim: Any) -> dict[str, Any]:
        Usd, UsdGeom = map(pxr_module, ("Usd", "UsdGeom"))

        visibility = UsdGeom.Imageable(prim).GetVisibilityAttr()
        codes = {*visibility.GetTimeSamples()}
        ancestor = prim
        while ancestor and not ancestor.IsPseudoRoot():
            form = UsdGeom.Xformable(ancestor)
            codes |= {*form.GetTimeSamples()} if form else set()
            ancestor = ancestor.GetParent()
        times = sorted(codes) or [0.0]
        poses, valid = [], []
        for code in times:
            self.cache.SetTime(Usd.TimeCode(code))
            poses.append(self.matrix(prim))
            valid.append(visibility.Get(Usd.TimeCode(code)) != "invisible")
        self.cache.SetTime(Usd.TimeCode.EarliestTime())
        a_second = self.stage.GetTimeCodesPerSecond()
        size = _value(prim, "gsrain:sizeLwh")
        return {
            "path": str(prim.GetPath()),
            "name": prim.GetDisplayName() or prim.GetName(),
            "role": _value(prim, "gsrain:role") or "",
            "class": str(_value(prim, "gsrain:class") or ""),
            "size_lwh": None if size is None else [float(value) for value in size],
            "times": [code / a_second for code in times],
            "poses": poses,
            "valid": valid,
            "rest": self.matrix(prim),
        }

    def is_invisible(self, prim: Any) -> bool:
        """Return whether a field is never visible."""
        UsdGeom = pxr_module("UsdGeom")

        while prim and not prim.IsPseudoRoot():
            visibility = UsdGeom.Imageable(prim).GetVisibilityAttr()
            if visibility and not visibility.GetNumTimeSamples() and visibility.Get() == "invisible":
                return True
            prim = prim.GetParent()
        return False

    def inherited(self, prim: Any, name: str) -> str:
        while prim and not prim.IsPseudoRoot():
            if (value := _value(prim, name)) is not None:
                return str(value)
            prim = prim.GetParent()
        return ""

    def matrix(self, prim: Any) -> list[list[float]]:
        return np.array(self.cache.GetLocalToWorldTransform(prim)).T.tolist()


def _is_inside(layer: Any, folder: Path) -> bool:
    return layer.anonymous or Path(layer.realPath).resolve().is_relative_to(folder.resolve())


def _value(prim: Any, name: str) -> Any:
    """Value of an attribute, at the earliest time if it changes; None without."""
    Usd = pxr_module("Usd")

    attribute = prim.GetAttribute(name)
    return attribute.Get(Usd.TimeCode.EarliestTime()) if attribute and attribute.HasValue() else None


def _array(prim: Any, name: str, width: int) -> Any:
    """Rows of an attribute, of its half-precision variant without the other; None without both."""
    value = _value(prim, name)
    value = _value(prim, f"{name}h") if value is None else value
    return None if value is None else np.array(value, np.float32).reshape(-1, width)


def _rows(values: Any, n: int, default: list[float]) -> Any:
    return np.tile(np.array(default, np.float32), (n, 1)) if values is None or len(values) < n else values[:n]


def _film_intrinsics(prim: Any) -> list[float]:
    """Width, height, focal lengths and principal point in pixels, of a picture of an assumed width."""
    focal, across, down = (
        float(_value(prim, name) or 1.0) for name in ("focalLength", "horizontalAperture", "verticalAperture")
    )
    height = max(1, round(_ASSUMED_WIDTH * down / across))
    pixels = _ASSUMED_WIDTH / across
    left, up = (float(_value(prim, f"{name}ApertureOffset") or 0.0) for name in ("horizontal", "vertical"))
    middle = [_ASSUMED_WIDTH / 2 - left * pixels, height / 2 + up * pixels]
    return [_ASSUMED_WIDTH, height, focal * pixels, focal * pixels, *middle]


def main(stage_file: str, folder: str, limit_bytes: str) -> None:
    """Read one stage; the result or the reason of a failure is in `RESULT` in the folder."""
    if int(limit_bytes) and sys.platform != "win32":
        import resource

        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        limit = int(limit_bytes) if hard == resource.RLIM_INFINITY else min(int(limit_bytes), hard)
        resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    try:
        result = read_stage(Path(stage_file), Path(folder))
    except ValueError as error:
        result = {"error": str(error)}
    except MemoryError:
        result = {"error": "it needs more memory than is free"}
    except OSError as error:
        for array in Path(folder).glob("*.npy"):  # makes room for the reason
            array.unlink()
        result = {"error": f"its Gaussians can't be written to {folder}: {error.strerror or error}"}
    (Path(folder) / RESULT).write_text(json.dumps(result))


if __name__ == "__main__":
    main(*sys.argv[1:])
