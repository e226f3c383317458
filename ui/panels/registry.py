"""Panels: their definition, the table of them, and panels of installed packages."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, get_args

from imgui_bundle import imgui

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.guide import PANELS_PAGE
from gsrain_engine.plugins import PANELS, Extension, load_extensions, warn_once

from ..parts import bind_parts
from ..widgets.fields import button
from .calibration import calibration_panel, disdrometer_panel
from .capture import capture_panel
from .display import display_panel, statistics_panel
from .drive import drive_panel
from .drive_plots import camera_mosaic_panel, drive_plots
from .edit import edit_panel, history_panel
from .jobs import jobs_panel, log_panel
from .layers import layers_panel
from .rain import rain_panel, rain_properties_panel
from .record import record_panel
from .select import select_panel
from .timeline import timeline_panel
from .views import views_panel
from .wet_look import wet_look_panel

DockSide = Literal["left", "left bottom", "right", "right bottom", "bottom"]


@dataclass(frozen=True)
class Panel:
    """A panel next to the viewport."""

    title: str
    side: DockSide
    draw: Callable[..., None]
    """Draws it; gets the editor's parts that its parameters name."""
    help: str = ""
    """Its contents in one sentence, which docs/guide/panels.md has, too."""
    page: str = PANELS_PAGE
    """Page of the guide about it, relative to that one, with the anchor of a heading; its ? opens it."""


# Table of panels

BUILT_IN_PANELS = (
    Panel("Layers", "left", layers_panel, page="selecting_and_editing.md#layers-and-history",
          help="Layers and actors: visibility, locks, number of Gaussians."),
    Panel("Views", "left", views_panel, page="looking_around.md#named-views",
          help="Named views with pictures: save the present one; a click goes to one."),
    Panel("History", "left", history_panel, page="selecting_and_editing.md#layers-and-history",
          help="Every step; a click goes to it."),
    Panel("Statistics", "left", statistics_panel, page="first_steps.md#other-panels",
          help="Frame time by stage, and what is drawn."),
    Panel("Edit", "left bottom", edit_panel, page="selecting_and_editing.md#editing",
          help="The selection, and the layers and actors chosen above."),
    Panel("Select", "left bottom", select_panel, page="selecting_and_editing.md#selecting",
          help="By attribute (opacity, size, height, ...) and by color; grow, shrink, invert, selection sets."),
    Panel("Rain", "right", rain_panel, page="rain.md",
          help="Intensity, exposure, wind, wetness, glass, lamps; below, folded, physics, regions and the rest."),
    Panel("Wet look", "right", wet_look_panel, page="wet_colors.md#wet-look",
          help="Wet colors of the scene, and fine-tuning of the diffusion model that can make them."),
    Panel("Drive", "right", drive_panel, page="../driving.md#in-the-window",
          help="A scenario driven by an agent; roll-outs side by side."),
    Panel("Capture", "right", capture_panel, page="captures.md#recorded-images-in-the-viewport",
          help="Recorded images next to the scene; reconstruct, recolor."),
    Panel("Record", "right", record_panel, page="timeline_and_recording.md#recording",
          help="A flythrough as video, frames, depth, labels; an image, or a sheet of intensities."),
    Panel("Display", "right", display_panel, page="looking_around.md#appearance-of-the-window",
          help="Rendering quality and speed; theme, text size."),
    Panel("Rain properties", "right bottom", rain_properties_panel, page="rain.md",
          help="Simulated rate, class, extinction and visibility; all other quantities that follow are folded."),
    Panel("Disdrometer", "right bottom", disdrometer_panel, page="../physics/drops.md#the-virtual-disdrometer",
          help="Counts the simulated drops."),
    Panel("Calibration", "right bottom", calibration_panel, page="calibration.md",
          help="The calibration of the rain, compared with another one."),
    Panel("Camera rig", "right bottom", camera_mosaic_panel, page="../driving.md#in-the-window",
          help="The images of the vehicle's cameras; a click looks from one."),
    Panel("Timeline", "bottom", timeline_panel, page="timeline_and_recording.md#timeline",
          help="Keyframes of the camera, and of every field with a diamond: the rain over time."),
    Panel("Drive plots", "bottom", drive_plots, page="../driving.md#in-the-window",
          help="Speed, acceleration, time to collision and gap of all roll-outs; a click goes to that time."),
    Panel("Jobs", "bottom", jobs_panel, page="first_steps.md#other-panels",
          help="Background jobs with progress, *Cancel*, result and report."),
    Panel("Log", "bottom", log_panel, page="first_steps.md#other-panels",
          help="Messages of the program, newest at the bottom; filtered by level and words."),
)  # fmt: skip


def all_panels() -> tuple[Panel, ...]:
    return (*BUILT_IN_PANELS, *installed_panels({each.title for each in BUILT_IN_PANELS}))


# Panels of other installed packages: one that fails shows its error, and the window continues


def installed_panels(used: set[str]) -> tuple[Panel, ...]:
    """Return the panels of other packages; unusable ones are omitted and logged. `used` are the existing titles."""
    fit: list[Panel] = []
    for extension, panel in load_extensions(PANELS, Panel):
        if panel.title in used | {each.title for each in fit}:
            warn_once(str(extension.unfit(f"there is a panel {panel.title!r} already")))
        elif panel.side not in get_args(DockSide):
            warn_once(str(extension.unfit(f"side {panel.side!r} is none of {', '.join(get_args(DockSide))}")))
        else:
            fit.append(replace(panel, draw=_guarded(extension, panel)))
    return tuple(fit)


def _guarded(extension: Extension, panel: Panel) -> Callable[[Editor], None]:
    """Return a function that draws a panel, or else its error."""
    failure = ""

    def draw(editor: Editor) -> None:
        nonlocal failure
        if failure:
            imgui.text_wrapped(failure)
            if button("Try again", "Draw the panel once more."):
                failure = ""
            return
        before = imgui.internal.ErrorRecoveryState()
        imgui.internal.error_recovery_store_state(before)
        try:
            bind_parts(panel.draw, editor)()
        except Exception as error:  # the panel is third-party code
            _recover(before)
            unfit = extension.unfit(error)
            failure = str(unfit)
            editor.status.report(unfit.with_traceback(error.__traceback__))

    return draw


def _recover(before: imgui.internal.ErrorRecoveryState) -> None:
    """Close the groups, tables and popups that a failed panel left open, and pop its styles."""
    io = imgui.get_io()
    settings = io.config_error_recovery_enable_assert, io.config_error_recovery_enable_tooltip
    io.config_error_recovery_enable_assert = io.config_error_recovery_enable_tooltip = False
    imgui.internal.error_recovery_try_to_recover_state(before)
    io.config_error_recovery_enable_assert, io.config_error_recovery_enable_tooltip = settings
