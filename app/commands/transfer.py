"""`gsrain transfer SCENE|CAPTURE -o DIR`: clear views become rainy views."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from cyclopts import Parameter

from gsrain_engine.appearance.before_and_after import BeforeAndAfter
from gsrain_engine.appearance.methods import open_transfer
from gsrain_engine.appearance.transfer import LeftOut, RainyView
from gsrain_engine.appearance.transfer_record import TransferRecord
from gsrain_engine.appearance.transferred_folder import check_transferred_folder, write_transferred
from gsrain_engine.render.pictures import write_sheet

from ..console import print
from .arguments import AllowOutside, JsonFile, let_names_lead_outside, write_numbers
from .outputs import check_picture, check_writable, hold
from .progress import progress_bar
from .transfer_options import MethodOptions, ViewOptions


def transfer(
    source: Annotated[str, Parameter(help="Scene file or folder, street (the built-in one), or a capture.")],
    /,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="Folder to write: a capture of rainy pictures.")],
    method: MethodOptions | None = None,
    views: ViewOptions | None = None,
    sheet: Annotated[Path | None, Parameter(help="Also write a picture of some views before and after.")] = None,
    allow_outside: AllowOutside = False,
    json: JsonFile = None,
) -> None:
    """Make views rainy. gsrain recolor and gsrain reconstruct take DIR as --images.

    DIR/clear holds the views as they were: another program may change them, and --method images takes what it made.
    """
    let_names_lead_outside(allow_outside)
    how, where = method or MethodOptions(), views or ViewOptions()
    settings, choice = how.settings, where.choice
    how.check()
    check_picture("--sheet", sheet)
    check_writable(sheet, json, folders=[output])
    check_transferred_folder(output)
    hold(output)
    # Kernels take a second to load: only now, that there is something to do.
    from .transferred_views import source_views

    opened = source_views(source, choice, where.capture)
    model = open_transfer(how.method, settings, opened.surroundings)
    told = msgspec.to_builtins(settings, enc_hook=str) | msgspec.to_builtins(choice)
    told["width_px"] = opened.width_px
    record = TransferRecord(how.method, opened.name, told, opened.to_world)
    rainy = write_transferred(output, model.transferred(opened.views), record, opened.mask)
    numbers = {"method": how.method, "width_px": opened.width_px} | _followed(rainy, len(opened.views), sheet)
    for note in numbers["notes"]:
        print(note)
    made = f"{numbers['views']} rainy views of {opened.name}"
    print(f"{output}: {made}, {opened.width_px} px wide, in {numbers['seconds']:.1f} s")
    if sheet is not None:
        print(sheet)
    write_numbers(json, numbers)


def _followed(rainy: Iterator[RainyView], count: int, sheet: Path | None) -> dict[str, Any]:
    """Make the views, with a bar; return the numbers of `--json`."""
    started, films, pictures = time.perf_counter(), list[float](), BeforeAndAfter(count)
    made, left_out = 0, LeftOut()
    with progress_bar("Rainy views", count, draws=True) as advance:
        for view in rainy:
            made += 1
            left_out.add(view)
            if view.film is not None:
                films.append(float(view.film.mean()))
            if sheet is not None:
                pictures.add(view)
            advance()
    seconds = time.perf_counter() - started
    if sheet is not None:
        write_sheet(sheet, pictures.picture())
    return {
        "views": made,
        "seconds": round(seconds, 3),
        "seconds_per_view": round(seconds / max(made, 1), 3),
        "film_share_mean": round(float(np.mean(films)), 5) if films else None,
        "notes": list(left_out.sentences),
    }
