"""The Jobs panel: watch and cancel background work."""

from imgui_bundle import imgui

from gsrain_engine.session.session import Session

from .job_fields import job_fields


def jobs_panel(session: Session) -> None:
    if not session.jobs:
        imgui.text_wrapped("Nothing goes on in the background. Make it rainy, Capture, Drive and Record start jobs.")
    for number, job in reversed(list(enumerate(session.jobs))):
        imgui.separator_text(job.title)
        job_fields(session, job, number)
    if len(session.jobs) > len(session.running_jobs) and imgui.button("Clear", (-1, 0)):
        session.clear_jobs()
