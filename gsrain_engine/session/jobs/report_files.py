"""Where the reports of the window's jobs stay."""

from datetime import datetime
from pathlib import Path

import platformdirs


def new_report(name: str) -> Path:
    """Make the folder for reports, and choose a file in it for one about `name`, by the present date and time."""
    folder = Path(platformdirs.user_data_dir("gsrain", appauthor=False)) / "reports"
    folder.mkdir(parents=True, exist_ok=True)
    return folder / f"{name.replace('/', '_')}_{datetime.now():%Y-%m-%d_%H-%M-%S}.html"
