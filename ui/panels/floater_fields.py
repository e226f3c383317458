"""Clean-up of floaters: rules, a search that selects what it finds, and what to do with it."""

from dataclasses import dataclass

import msgspec
from imgui_bundle import imgui

from gsrain_engine.session.edits.floaters import FloaterRules
from gsrain_engine.session.edits.marking import delete_selected
from gsrain_engine.session.jobs.floater_job import TITLE, FloaterJob
from gsrain_engine.session.session import Session

from ..widgets.fields import field_info, plain_label


@dataclass(slots=True)
class _Chosen:
    """The rules that are set; they are no part of the document."""

    rules: FloaterRules


_chosen = _Chosen(FloaterRules())
_RANGES = {"opacity_below": (1.0, "%.3g"), "size_above_m": (20.0, "%.3g"), "isolation_above": (50.0, "%.3g x median")}
"""Where each slider ends, and how its value is written."""


def floater_fields(session: Session) -> None:
    """Edit the rules, search, delete."""
    for name, (high, written) in _RANGES.items():
        info, value = field_info(name, FloaterRules), getattr(_chosen.rules, name)
        plain_label(f"{info.title} ({info.unit})" if info.unit else info.title, info.help)
        flags = imgui.SliderFlags_.always_clamp | imgui.SliderFlags_.logarithmic
        changed, value = imgui.slider_float(f"##{name}", value, 0.0, high, written if value else "off", flags)
        if changed:
            _chosen.rules = msgspec.structs.replace(_chosen.rules, **{name: value})
    jobs = [job for job in session.jobs if isinstance(job, FloaterJob)]
    job = jobs[-1] if jobs else None
    if job is not None and job.state == "running":
        imgui.progress_bar(job.progress.fraction, (-1, 0), job.progress.message)
        if imgui.button("Cancel##floaters", (-1, 0)):
            job.cancel()
        imgui.set_item_tooltip("Stop searching; the selection stays as it was.")
        return
    if imgui.button(TITLE, (-1, 0)):
        session.start(FloaterJob(session.scene, _chosen.rules))
    imgui.set_item_tooltip(
        "Select what any one of the rules calls a floater, in background layers that are not locked."
    )
    is_latest = session.history.undo_label == TITLE
    if job is not None and job.found_count is not None and (is_latest or not job.found_count):
        imgui.text_wrapped(job.progress.message + ".")
        if job.found_count:
            if imgui.button(f"Delete {job.found_count:,} floaters", (-1, 0)):
                session.edit("Delete floaters", delete_selected)
            imgui.set_item_tooltip("Delete what was found; undo brings it back.")
