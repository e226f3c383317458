"""Commands of the rain: intensity, visible parts and keyframes."""

from collections.abc import Callable

from gsrain_engine.editor.editor import Editor
from gsrain_engine.rain.keyframes import NO_KEYFRAMES

from ..panels.rain import PICK_TOOL
from ..panels.rain_keyframes import add_passing_shower, ask_for_rate_file
from ..widgets.fields import toggle_keyframe
from .base import Command

_MENU = "Rain"


def _set_intensity(rate: float) -> Callable[[Editor], None]:
    return lambda session: session.change_rain(f"Intensity {rate:g} mm/h", intensity_mm_h=rate)


def _switch(field: str, title: str) -> Callable[[Editor], None]:
    def run(session: Editor) -> None:
        is_on = not getattr(session.rain, field)
        session.change_rain(f"{title} {'on' if is_on else 'off'}", None, **{field: is_on})

    return run


def _is_on(field: str) -> Callable[[Editor], bool]:
    return lambda session: getattr(session.rain, field)


def _shows_regions(session: Editor) -> bool:
    return session.view.show_streak_region and session.view.show_haze_region


def _show_regions(session: Editor) -> None:
    session.view.show_streak_region = session.view.show_haze_region = not _shows_regions(session)


def _use(tool: str) -> Callable[[Editor], None]:
    return lambda session: setattr(session.view, "tool", "" if session.view.tool == tool else tool)


def _uses(tool: str) -> Callable[[Editor], bool]:
    return lambda session: session.view.tool == tool


INTENSITY_ACTIONS = tuple(
    Command(
        "Set no rain" if rate == 0 else f"Set {rate:g} mm/h",
        _set_intensity(rate),
        _MENU,
        help="Where the intensity has keys: set one at the present time.",
        is_on=lambda session, rate=rate: session.rain_now.intensity_mm_h == rate,
    )
    for rate in (0.0, 1.2, 8.5, 12.0)
)

RAIN_ACTIONS = (
    Command(
        "Draw streaks", _switch("streaks", "Streaks"), _MENU, help="Near drops as streaks.", is_on=_is_on("streaks")
    ),
    Command("Draw haze", _switch("haze", "Haze"), _MENU, help="For far drops.", is_on=_is_on("haze")),
    Command(
        "Keep rain from under roofs",
        _switch("roofs", "Roofs"),
        _MENU,
        help="Looks for bridges, canopies and trees once.",
        is_on=_is_on("roofs"),
    ),
    Command("Show rain regions", _show_regions, _MENU, help="Draw their edges in the view.", is_on=_shows_regions),
    Command(
        "Edit rain regions",
        _use("Rain regions"),
        _MENU,
        help="Drag the faces of the boxes that drops and haze stand in.",
        is_on=_uses("Rain regions"),
    ),
    Command(
        "Pick the drop colour",
        _use(PICK_TOOL),
        _MENU,
        help="Click a pixel of the view or drag a rectangle: drops take its colour.",
        is_on=_uses(PICK_TOOL),
    ),
    Command(
        "Take the drop colour from the sky",
        lambda session: session.change_rain("Drop colour from the sky", drop_color=None),
        _MENU,
        help="The mean of the scene's own sky in linear light (eq. 3).",
        is_possible=lambda session: session.rain.drop_color is not None,
    ),
)

WEATHER_ACTIONS = (
    Command(
        "Key the intensity now",
        lambda session: toggle_keyframe(session, "intensity_mm_h"),
        _MENU,
        help="Keep the present intensity as a key at the clock's time, or remove the key that is there.",
    ),
    Command(
        "Key the wind now",
        lambda session: toggle_keyframe(session, "wind_m_s"),
        _MENU,
        help="Keep the present wind as a key at the clock's time, or remove the key that is there.",
    ),
    Command(
        "Key the exposure now",
        lambda session: toggle_keyframe(session, "exposure_s"),
        _MENU,
        help="Keep the present shutter time as a key at the clock's time, or remove the key that is there.",
    ),
    Command(
        "Let a shower pass", add_passing_shower, _MENU, help="60 s from now on: from 0 to 12 mm/h and back, smooth."
    ),
    Command(
        "Import a disdrometer's series...",
        ask_for_rate_file,
        _MENU,
        help="Its rain rates become keys of the intensity.",
        is_possible=lambda session: session.lab.busy is None,
    ),
    Command(
        "Clear the weather's keys",
        lambda session: session.set_weather("Clear the keys", NO_KEYFRAMES),
        _MENU,
        help="The rain stays as it is set.",
        is_possible=lambda session: bool(session.weather.keys),
    ),
)
