"""The Jobs panel: start, watch and cancel background work."""

from imgui_bundle import imgui

from gsrain_engine.session.background_job import BackgroundJob
from gsrain_engine.session.rainy_look_job import TITLE
from gsrain_engine.session.session import Session

from .rain_panel import WARNING


def jobs_panel(session: Session) -> None:
    """Draw the panel."""
    imgui.begin_disabled(bool(session.running_jobs) or session.staged is not None)
    if imgui.button(TITLE, (-1, 0)):
        session.make_rainy()
    imgui.end_disabled()
    imgui.set_item_tooltip("Give the scene an overcast sky and a wet road; undo brings the clear one back.")
    for number, job in reversed(list(enumerate(session.jobs))):
        imgui.separator_text(job.title)
        _job(job, number)
    if len(session.jobs) > len(session.running_jobs) and imgui.button("Clear", (-1, 0)):
        session.clear_jobs()


def _job(job: BackgroundJob, number: int) -> None:
    if job.state == "running":
        imgui.progress_bar(job.progress.fraction, (-1, 0), f"{100 * job.progress.fraction:.0f} %")
        imgui.text_wrapped(job.progress.message)
        if imgui.button(f"Cancel##{number}", (-1, 0)):
            job.cancel()
        imgui.set_item_tooltip("Stop the job; the scene stays as it is.")
    elif job.state == "failed":
        imgui.text_colored(WARNING, "Failed")
        imgui.text_wrapped(job.error or "")
        if job.details and imgui.tree_node(f"Traceback##{number}"):
            imgui.text_unformatted(job.details)
            imgui.tree_pop()
    else:
        imgui.text(job.progress.message if job.state == "finished" else "Cancelled")
