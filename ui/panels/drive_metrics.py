"""The table of metrics: a column for each roll-out that is open."""

from collections.abc import Callable

from imgui_bundle import imgui

from gsrain_engine.drive.metrics.summary import DriveMetrics
from gsrain_engine.session.session import Session

from .drive_colors import curve_colors

_MOST = 5
_NONE = "-"


def _number(value: float | None, form: str = "{:.2f}") -> str:
    return _NONE if value is None else form.format(value)


def _percent(value: float | None) -> str:
    return _NONE if value is None else f"{100 * value:.1f} %"


_ROWS: tuple[tuple[str, str, Callable[[DriveMetrics], str]], ...] = (
    ("End", "Why the drive ended.", lambda m: m.end),
    ("Hit", "Who was hit; background is anything of the scene.", lambda m: m.collided_with or _NONE),
    ("at (s)", "When it was hit, seconds since the scenario began.", lambda m: _number(m.collision_time_s)),
    ("at (m/s)", "Speed of the ego vehicle then.", lambda m: _number(m.collision_speed_m_s)),
    ("Min. TTC (s)", "Least time to collision, bumper gap over closing speed, capped at 10 s.",
     lambda m: _number(m.min_ttc_s)),
    ("Min. gap (m)", "Least bumper gap to who is ahead in the lane.", lambda m: _number(m.min_gap_m)),
    ("C, points", "Planned points that collide, of all planned points (the paper's C).",
     lambda m: _percent(m.planned_point_collision_rate)),
    ("C, frames", "Moments whose plan has any point that collides.",
     lambda m: _percent(m.planned_frame_collision_rate)),
    ("S, driven", "Share of moments within the paper's comfort limits, of the motion as driven.",
     lambda m: _number(m.comfort_executed, "{:.3f}")),
    ("S, planned", "The same of the plans: HUGSIM's comfort.", lambda m: _number(m.comfort_planned, "{:.3f}")),
    ("Braking (m/s\u00b2)", "Hardest deceleration of a step.", lambda m: _number(m.hardest_braking_m_s2)),
    ("Distance (m)", "Driven.", lambda m: _number(m.distance_m, "{:.1f}")),
    ("Route", "Share of the route ahead of the start that was driven.", lambda m: _percent(m.route_completion)),
    ("HD-score", "HUGSIM's score; none where it can't be measured.", lambda m: _number(m.hdscore, "{:.3f}")),
)  # fmt: skip


def drive_metrics(session: Session) -> None:
    drives = session.drives
    runs = sorted(zip(drives.opened, curve_colors(drives.opened), strict=True), key=lambda each: each[0].intensity_mm_h)
    runs = runs[:_MOST]
    flags = imgui.TableFlags_.row_bg | imgui.TableFlags_.sizing_stretch_prop
    if not imgui.begin_table("metrics", 1 + len(runs), flags):
        return
    imgui.table_next_row()
    imgui.table_next_column()
    imgui.text_disabled("mm/h")
    for opened, hue in runs:
        imgui.table_next_column()
        mark = " *" if opened is drives.playing and len(runs) > 1 else ""
        imgui.text_colored(hue, f"{opened.intensity_mm_h:g}{mark}")
        imgui.set_item_tooltip(f"{opened.title}{'; it plays' if opened is drives.playing else ''}.")
    for title, help_text, value in _ROWS:
        imgui.table_next_row()
        imgui.table_next_column()
        imgui.text(title)
        imgui.set_item_tooltip(help_text)
        for opened, _ in runs:
            imgui.table_next_column()
            imgui.text(value(opened.metrics))
    imgui.end_table()
    if not all(opened.metrics.with_background for opened, _ in runs):
        imgui.text_disabled("C counts road users only.")
        imgui.set_item_tooltip("Planned points were not tested against the scene's background: the file has no scene.")
