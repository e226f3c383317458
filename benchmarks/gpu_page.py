"""Tables of `benchmarks/gpu.py` in Markdown, each figure with its target."""

from collections.abc import Iterator, Sequence
from typing import Any

Row = dict[str, Any]
BEGIN, END = "<!-- figures: written by make gpu -->", "<!-- end of figures -->"

MAX_OF_GSPLAT = 0.8
"""Whole frame of tiles, as a share of gsplat's."""
MAX_RAINY = 1.2
"""Rainy frame, as a multiple of the clear one."""
MAX_READ_MS = 1.5
"""8-bit read-back of 1920x1080."""
MAX_OF_PLAIN = 1.4
"""Training step, as a multiple of the plain loop's."""
MAX_OF_ORDINARY = 1.3
"""Frame of a large scene's cut, as a multiple of that of a scene of 1 M Gaussians."""

BACKENDS = ("opengl-tiles", "opengl-quads", "gsplat")


def with_figures(page: str, text: str) -> str:
    """Replace the text between the marks of a page; a page without marks becomes the text alone."""
    before, mark, rest = page.partition(BEGIN)
    if not mark or END not in rest:
        return text
    return f"{before}{BEGIN}\n\n{text}\n{END}{rest.partition(END)[2]}"


def figures(results: dict[str, tuple[list[Row], str]]) -> str:
    """Format the rows of each part and its error."""
    lines: list[str] = []
    for name, (rows, error) in results.items():
        lines += [f"### {_TITLES.get(name, name)}", ""]
        if rows:
            lines += [*_TABLES[name](rows), ""]
        if error:
            lines += [f"**This part is incomplete**: {_cell(error)}", ""]
    return "\n".join(lines)


def _machine(rows: list[Row]) -> Iterator[str]:
    yield from _table(["", "machine"], rows[0].items())


def _build(rows: list[Row]) -> Iterator[str]:
    yield "Seconds until the first image, both at the same time; kernels are compiled where they are not cached."
    yield ""
    yield from _table(["kernels", "s"], ((row["kernels"], row.get("seconds")) for row in rows))
    yield from _errors(rows)


def _sort(rows: list[Row]) -> Iterator[str]:
    yield from _table(
        ["splats", "check", "target: no fault"], ((f"{row['splats']:,}", row["check"], row["is_right"]) for row in rows)
    )


def _frames(rows: list[Row]) -> Iterator[str]:
    yield "Median GPU time of a whole frame in ms: OpenGL by timer queries, gsplat by CUDA events."
    yield ""
    cells: list[Sequence[Any]] = []
    for row in rows:
        took = row["ms"]
        share = _ratio(took.get("opengl-tiles"), took.get("gsplat"))
        cells.append(
            (row["scene"], row["size"], *(took.get(each) for each in BACKENDS), share, _met(share, MAX_OF_GSPLAT))
        )
    yield from _table(["scene", "size", *BACKENDS, "tiles / gsplat", f"target: {MAX_OF_GSPLAT:g}"], cells)
    stages = list(dict.fromkeys(stage for row in rows for stage in row.get("stages_ms", {})))
    if stages:
        yield from ("", "Stages of tiles, ms (`sort` includes the binning by tile):", "")
        yield from _table(
            ["scene", "size", "splats", *stages],
            ((row["scene"], row["size"], f"{row['splats']:,}", *(row["stages_ms"].get(each) for each in stages))
             for row in rows if "stages_ms" in row),
        )  # fmt: skip
    yield from _errors(rows)


def _rain(rows: list[Row]) -> Iterator[str]:
    yield (
        "Median GPU time of a whole frame in ms, clear and with 8.5 mm/h of the preset `paper`; the processor creates "
        "the rain before."
    )
    yield ""
    cells: list[Sequence[Any]] = []
    for row in (each for each in rows if "clear_ms" in each):
        share = _ratio(row["rainy_ms"], row["clear_ms"])
        took = (row["clear_ms"], row["rainy_ms"], row["creating_ms"])
        cells.append((row["scene"], row["size"], row["backend"], *took, share, _met(share, MAX_RAINY)))
    names = ["scene", "size", "back end", "clear", "rainy", "creating rain", "rainy / clear", f"target: {MAX_RAINY:g}"]
    yield from _table(names, cells)
    yield from _errors(rows)


def _training(rows: list[Row]) -> Iterator[str]:
    yield (
        "Median time of a step in ms: `gsrain reconstruct` on the street, and a plain loop around gsplat (L1 and "
        "D-SSIM, fused Adam) with 128 k random Gaussians of SH degree 1."
    )
    yield ""
    cells: list[Sequence[Any]] = []
    for row in rows:
        share = _ratio(row.get("gsrain_ms"), row.get("plain_ms"))
        took = (row.get("gsrain_ms"), row.get("plain_ms"))
        cells.append((row["size"], row.get("gaussians"), *took, share, _met(share, MAX_OF_PLAIN)))
    names = ["size", "Gaussians", "gsrain", "plain loop", "gsrain / plain loop", f"target: {MAX_OF_PLAIN:g}"]
    yield from _table(names, cells)
    yield from _errors(rows)


def _read_back(rows: list[Row]) -> Iterator[str]:
    yield "Median wall time in ms from a drawn image on the GPU to its 8 bits in memory."
    yield ""
    cells = ((row["way"], row["size"], row["ms"], _met(row["ms"], MAX_READ_MS)) for row in rows)
    yield from _table(["image", "size", "ms", f"target: {MAX_READ_MS:g} ms"], cells)


def _images(rows: list[Row]) -> Iterator[str]:
    yield "PSNR in dB against the image of `cpu`."
    yield ""
    names = [each for each in BACKENDS if each != "gsplat"]
    cells = ((row["scene"], row["mm/h"], row["size"], *(row["psnr_db"].get(each) for each in names)) for row in rows)
    yield from _table(["scene", "mm/h", "size", *names], cells)
    yield from _errors(rows)


def _lod(rows: list[Row]) -> Iterator[str]:
    yield (
        "Median GPU time of a frame of tiles in ms: the level-of-detail cut of a large scene, all its Gaussians, and a "
        "scene of ordinary size. The processor finds the cut before, and uploads its masks."
    )
    yield ""
    cells: list[Sequence[Any]] = []
    for row in rows:
        took = row["ms"]
        share = _ratio(took.get("cut"), took.get("ordinary"))
        counts = (f"{row['gaussians']:,}", f"{row.get('drawn', 0):,}")
        times = (row.get("finding_ms"), took.get("cut"), took.get("all"), took.get("ordinary"))
        cells.append((row["scene"], row["size"], *counts, *times, share, _met(share, MAX_OF_ORDINARY)))
    other = rows[0].get("ordinary", "ordinary scene")
    names = ["scene", "size", "Gaussians", "of the cut", "finding it", "frame, cut", "frame, all", f"frame, {other}"]
    yield from _table([*names, f"cut / {other}", f"target: {MAX_OF_ORDINARY:g}"], cells)
    yield from _errors(rows)


def _tests(rows: list[Row]) -> Iterator[str]:
    cells = ((row["tests"], "<br>".join([row["summary"], *map(_cell, row["failed"])])) for row in rows)
    yield from _table(["tests", "result"], cells)


def _ratio(one: float | None, other: float | None) -> float | None:
    return one / other if one is not None and other else None


def _met(value: float | None, limit: float) -> str:
    return "not measured" if value is None else "met" if value <= limit else "not met"


def _errors(rows: list[Row]) -> Iterator[str]:
    """One line for each different error."""
    found: dict[tuple[str, str], str] = {}
    for row in rows:
        for name, error in row["errors"].items():
            found.setdefault((name, error), f"{row.get('scene', '')} {_cell(row.get('size'))}".strip())
    for (name, error), place in found.items():
        yield from ("", f"**{name} failed**{f' ({place})' if place else ''}: {_cell(error)}")


def _table(names: Sequence[str], rows: Any) -> Iterator[str]:
    for line in (names, ["---"] * len(names), *rows):
        yield "| " + " | ".join(map(_cell, line)) + " |"


def _cell(value: Any) -> str:
    match value:
        case None:
            return ""
        case bool():
            return "met" if value else "not met"
        case float():
            return f"{value:.1f}" if value >= 20 else f"{value:.2f}"
        case [int(), int()] | (int(), int()):
            return "x".join(map(str, value))
        case str():
            return " ".join(value.split()).replace("|", "/")[:600]
        case _:
            return str(value)


_TITLES = {
    "machine": "Machine", "build": "Kernels", "sort": "Depth sort", "frames": "Frames", "rain": "Rain",
    "training": "Training step", "read_back": "8-bit read-back", "images": "Images", "gpu_tests": "Tests on the GPU",
    "opengl_tests": "OpenGL tests", "lod": "Level of detail",
}  # fmt: skip
_TABLES = {
    "machine": _machine, "build": _build, "sort": _sort, "frames": _frames, "rain": _rain, "training": _training,
    "read_back": _read_back, "images": _images, "gpu_tests": _tests, "opengl_tests": _tests, "lod": _lod,
}  # fmt: skip
