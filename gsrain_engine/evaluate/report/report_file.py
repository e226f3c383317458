"""The page of a run as a file that needs nothing beside it."""

from pathlib import Path

from gsrain_engine.scene.atomic_files import whole_file

from .run_report import RunReport


def write_report(file: Path, report: RunReport) -> None:
    """Write a page of HTML with its style, curves and pictures inside; the file appears whole or not at all.

    Missing parents are made.
    """
    from .page import report_page  # Jinja loads slowly, and most runs write no page

    page = report_page(report)
    file.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(file) as beside:
        beside.write_text(page, encoding="utf-8")
