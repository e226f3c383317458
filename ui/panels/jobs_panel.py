"""The Jobs panel: start, watch and cancel background work."""

from imgui_bundle import imgui

from gsrain_engine.session.jobs.rainy_look_job import TITLE, make_rainy_look
from gsrain_engine.session.session import Session

from .job_fields import job_fields


def jobs_panel(session: Session) -> None:
    """Draw the panel."""
    imgui.begin_disabled(bool(session.running_jobs) or session.staged is not None)
    if imgui.button(TITLE, (-1, 0)):
        make_rainy_look(session)
    imgui.end_disabled()
    imgui.set_item_tooltip(
        "Give the scene an overcast sky and a wet road, which come with the rain's intensity; undo takes them back."
    )
    for number, job in reversed(list(enumerate(session.jobs))):
        imgui.separator_text(job.title)
        job_fields(session, job, number)
    if len(session.jobs) > len(session.running_jobs) and imgui.button("Clear", (-1, 0)):
        session.clear_jobs()
