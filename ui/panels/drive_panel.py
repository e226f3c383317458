"""The Drive panel: a closed-loop test through the scene as it is now, and the roll-outs that are open."""

from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.session.session import Session

from .drive_fields import agent_fields, rain_fields, scenario_choice
from .drive_metrics import drive_metrics
from .job_fields import job_fields
from .rain_panel import WARNING
from .rollout_fields import rollout_fields
from .scenario_fields import scenario_fields

_ICONS = icons_fontawesome_6
_HELP = (
    "Drive through the scene as it is now, with your edits, in the background.\n"
    "The roll-out is opened as soon as it is finished; the scene stays as it is."
)


def drive_panel(session: Session) -> None:
    wanted = session.drives.wanted
    scenario_choice(session)
    if imgui.tree_node("Change the scenario"):
        scenario_fields(wanted)
        imgui.tree_pop()
    agent_fields(wanted)
    rain_fields(session)
    if wanted.problem is not None:
        _warn(wanted.problem)
    _begin(session)
    imgui.separator_text("Roll-outs")
    rollout_fields(session)
    if session.drives.playing is not None and imgui.collapsing_header("Metrics", imgui.TreeNodeFlags_.default_open):
        drive_metrics(session)


def _begin(session: Session) -> None:
    newest = session.drives.newest_job(session)
    if newest is not None and newest[1].state == "running":
        imgui.separator_text(newest[1].title)
        job_fields(session, newest[1], newest[0])
        return
    why_not = session.drives.why_not(session)
    imgui.spacing()
    imgui.begin_disabled(why_not is not None)
    if imgui.button(f"{_ICONS.ICON_FA_CAR_SIDE}  Drive###drive", (-1, 1.5 * imgui.get_frame_height())):
        session.drives.start(session)
    imgui.end_disabled()
    imgui.set_item_tooltip(_HELP if why_not is None else why_not)
    if why_not is not None:
        _warn(why_not)
    elif newest is not None and newest[1].state != "finished":
        job_fields(session, newest[1], newest[0])


def _warn(words: str) -> None:
    imgui.push_style_color(imgui.Col_.text, WARNING)
    imgui.text_wrapped(words)
    imgui.pop_style_color()
