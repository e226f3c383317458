"""One job as panels show it: how far it is, what it shows, what stops it, and what came of it."""

import webbrowser

from imgui_bundle import ImVec2, imgui

from gsrain_engine.session.jobs.background_job import BackgroundJob
from gsrain_engine.session.jobs.scene_job import SceneJob
from gsrain_engine.session.session import Session

from .rain_panel import WARNING

_HIGHEST_PREVIEW_EM = 9.0


def job_fields(session: Session, job: BackgroundJob, number: int) -> None:
    """Draw a job; `number` tells it from the others of the panel."""
    if job.state == "running":
        imgui.progress_bar(job.progress.fraction, (-1, 0), f"{100 * job.progress.fraction:.0f} %")
        imgui.text_wrapped(job.progress.message)
        _preview(session, job)
        if imgui.button(f"Cancel##{number}", (-1, 0)):
            job.cancel()
        imgui.set_item_tooltip("Stop the job; the scene stays as it is, and what was recorded so far can be played.")
    elif job.state == "failed":
        imgui.text_colored(WARNING, "Failed")
        imgui.text_wrapped(job.error or "")
        if job.details and imgui.tree_node(f"Traceback##{number}"):
            imgui.text_unformatted(job.details)
            imgui.tree_pop()
    else:
        imgui.text_wrapped(job.progress.message if job.state == "finished" else "Cancelled")
        if isinstance(job, SceneJob) and job.report is not None:
            if imgui.button(f"Report##{number}", (-1, 0)):
                webbrowser.open(job.report.as_uri())
            imgui.set_item_tooltip(f"Show figures, views and timings in a browser: {job.report}")


def _preview(session: Session, job: BackgroundJob) -> None:
    """Show the job's newest picture, as wide as the panel and not too high."""
    if (preview := session.previews.get(job)) is None:
        return
    width = min(
        imgui.get_content_region_avail().x, _HIGHEST_PREVIEW_EM * imgui.get_font_size() * preview.width / preview.height
    )
    imgui.image(imgui.ImTextureRef(preview.name), ImVec2(width, width * preview.height / preview.width))
    imgui.set_item_tooltip("What the job has just made.")
