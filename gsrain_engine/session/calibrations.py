"""Which calibration a session's rain follows; what is wrong with one is kept in `session.problem`."""

import logging

from gsrain_engine.rain.calibration import load_calibration

from .log import told
from .session import Session

logger = logging.getLogger("gsrain")


def use_calibration(session: Session, name: str) -> None:
    """Let the rain follow another calibration, by name or file."""
    try:
        load_calibration(name)
    except (ValueError, OSError) as error:
        session.problem = str(error)
        logger.error("%s", error)
    else:
        session.lab.add_file(name)
        session.change_rain("Calibration", calibration=name)


def compare_calibration(session: Session, name: str) -> None:
    """Show another calibration beside the rain's own."""
    try:
        session.lab.compare_with(name)
    except (ValueError, OSError) as error:
        session.problem = str(error)
        logger.error("%s", error)


def use_fitted_calibration(session: Session) -> None:
    """Keep the lab's last fit in a file, and let the rain follow it."""
    try:
        path = session.lab.keep_fitted()
    except OSError as error:
        session.problem = told("The calibration can't be saved", error)
    else:
        use_calibration(session, path)
