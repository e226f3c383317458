"""Where the reports of the window's jobs stay."""

import re
from datetime import datetime
from pathlib import Path

import platformdirs

_LONGEST = 120
"""Bytes of what a report is about that go into its file's name."""


def new_report(name: str) -> Path:
    """Choose a file for one about `name`, by the present date and time; its folder need not be there yet."""
    folder = platformdirs.user_data_path("gsrain", appauthor=False) / "reports"
    about = re.sub(r"[/\x00-\x1f\x7f]", "_", name).encode(errors="replace")[:_LONGEST].decode(errors="ignore")
    when = f"{datetime.now():%Y-%m-%d_%H-%M-%S}"
    places = (folder / f"{about}_{when}{suffix}.html" for suffix in ("", *(f"_{number}" for number in range(2, 100))))
    return next((place for place in places if not place.exists()), folder / f"{about}_{when}.html")
