"""Which calibration a document's rain follows; what is wrong with one is kept in `document.problem`."""

import logging

from gsrain_engine.rain.calibration import load_calibration

from ..document.edited_document import EditedDocument
from ..log import told
from .rain_lab import RainLab

logger = logging.getLogger("gsrain")


def use_calibration(document: EditedDocument, lab: RainLab, name: str) -> None:
    """Let the rain follow another calibration, by name or file."""
    try:
        load_calibration(name)
    except (ValueError, OSError) as error:
        document.problem = str(error)
        logger.error("%s", error)
    else:
        lab.add_file(name)
        document.change_rain("Calibration", calibration=name)


def compare_calibration(document: EditedDocument, lab: RainLab, name: str) -> None:
    """Show another calibration beside the rain's own."""
    try:
        lab.compare_with(name)
    except (ValueError, OSError) as error:
        document.problem = str(error)
        logger.error("%s", error)


def use_fitted_calibration(document: EditedDocument, lab: RainLab) -> None:
    """Keep the lab's last fit in a file, and let the rain follow it."""
    try:
        path = lab.keep_fitted()
    except OSError as error:
        document.problem = told("The calibration can't be saved", error)
    else:
        use_calibration(document, lab, path)
