"""What screenshots are called."""

from datetime import datetime
from pathlib import Path


def new_screenshot(folder: Path) -> Path:
    """Choose a name in a folder by the present date and time; one that is not taken yet."""
    name = f"gsrain_{datetime.now():%Y-%m-%d_%H-%M-%S}"
    taken = {each.name for each in folder.glob(f"{name}*.png")}
    chosen, number = f"{name}.png", 1
    while chosen in taken:
        number += 1
        chosen = f"{name}_{number}.png"
    return folder / chosen
