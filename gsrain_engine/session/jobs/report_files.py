"""Where the reports of the window's jobs stay."""

from datetime import datetime
from pathlib import Path

import platformdirs


def new_report(name: str) -> Path:
    """Choose a file for one about `name`, by the present date and time; its folder need not be there yet."""
    folder = platformdirs.user_data_path("gsrain", appauthor=False) / "reports"
    return folder / f"{name.replace('/', '_')}_{datetime.now():%Y-%m-%d_%H-%M-%S}.html"
