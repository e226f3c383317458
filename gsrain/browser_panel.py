"""Rain panel of the window in the browser: viser's controls, made of the field table."""

import math
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from typing import Any

import msgspec

from gsrain_engine.choices import LAMP_WORDS
from gsrain_engine.editor.document import with_preset
from gsrain_engine.fields import Field, field_of, fields_of
from gsrain_engine.presets import shipped_config_names
from gsrain_engine.rain.settings import CALIBRATED_UP_TO_MM_H, HEAVIEST_MM_H, RegionBox, load_preset
from gsrain_engine.rain.settings import RainSettings as RainSettings
from gsrain_engine.safe_io.errors import convert_checked
from gsrain_engine.scene.camera import DEFAULT_EXPOSURE_S
from gsrain_engine.scene.sensor import sensor_names

_ELSEWHERE = ("calibration", "max_copies", "haze_count", "keep_light")
"""Settings without a group that the desktop's Rain panel leaves to files, too."""
_NO_PRESET = "–"  # noqa: RUF001  shown while the rain is none of the presets
_STEPS = 300.0  # of a slider, at least
_INITIAL: dict[str, Any] = {
    "exposure_s": DEFAULT_EXPOSURE_S, "wind_m_s": (0.0, 0.0), "drop_color": (0.7, 0.7, 0.7),
    "haze_region": RainSettings().streak_region, "wetness": 1.0, "lamps": "auto", "sensor": "automotive",
}  # fmt: skip
"""First values of settings that can be none, where the field table has none."""
_Handles = Sequence[Any]


class RainPanel:
    """Controls for rain settings, the same for all browsers."""

    def __init__(self, gui: Any, rain: RainSettings, on_change: Callable[[RainSettings], None]) -> None:
        """Add the controls to viser's `gui`; `on_change` receives each change by a person, on any thread."""
        self._rain, self._on_change = rain, on_change
        self._inputs: dict[str, _Input] = {}
        presets = (_NO_PRESET, *shipped_config_names("rain"))
        self._preset = gui.add_dropdown("Preset", presets, hint="Settings that are shipped with the program.")
        self._preset.on_update(self._load_preset)
        groups: dict[str, list[Field]] = {}
        for each in fields_of(RainSettings):
            if each.name not in _ELSEWHERE:
                groups.setdefault(each.group, []).append(each)
        for group, members in groups.items():
            with gui.add_folder(group, expand_by_default=False) if group else nullcontext():
                for each in members:
                    value = getattr(rain, each.name)
                    self._inputs[each.name] = _Input(gui, each, value, self._changed)
                    if each.name == "intensity_mm_h":
                        self._add_beyond(gui, rain)

    def _add_beyond(self, gui: Any, rain: RainSettings) -> None:
        """Add the checkbox that extends the slider of the intensity, as the desktop's."""
        slider, is_beyond = self._inputs["intensity_mm_h"].first, rain.intensity_mm_h > CALIBRATED_UP_TO_MM_H
        hint = f"Above {CALIBRATED_UP_TO_MM_H:g} mm/h the calibration is extrapolated."
        beyond = gui.add_checkbox(f"Up to {HEAVIEST_MM_H:g}", is_beyond, hint=hint)
        slider.max = HEAVIEST_MM_H if is_beyond else CALIBRATED_UP_TO_MM_H

        @beyond.on_update
        def _(event: Any) -> None:
            if event.client is not None:
                slider.max = HEAVIEST_MM_H if beyond.value else CALIBRATED_UP_TO_MM_H
                if self._rain.intensity_mm_h > slider.max:
                    slider.value = slider.max
                    self._changed(field_of(RainSettings, "intensity_mm_h"), slider.max, event.client)

    def display(self, rain: RainSettings) -> None:
        """Set all controls to other settings, without a call of `on_change`."""
        self._rain = rain
        for name, each in self._inputs.items():
            each.display(getattr(rain, name))

    def _load_preset(self, event: Any) -> None:
        if event.client is None or self._preset.value not in shipped_config_names("rain"):
            return
        rain = with_preset(self._rain, load_preset(self._preset.value))
        self.display(rain)
        self._on_change(rain)

    def _changed(self, info: Field, value: Any, client: Any) -> None:
        try:
            values = msgspec.to_builtins(self._rain) | {info.name: msgspec.to_builtins(value)}
            rain = convert_checked(values, RainSettings)
        except ValueError as error:
            client.add_notification(info.title, str(error), color="red")
            self._inputs[info.name].display(getattr(self._rain, info.name))
            return
        self._rain = rain
        self._preset.value = _NO_PRESET
        self._on_change(rain)


class _Input:
    """Controls of one setting: those of its type, after a checkbox if it can be none."""

    def __init__(self, gui: Any, info: Field, value: Any, on_change: Callable[[Field, Any, Any], None]) -> None:
        self._info, self._on_change = info, on_change
        self._switch: Any = None
        if info.is_optional:
            hint = f"{info.help} Off: {info.extra.get('none', 'by default')}."
            self._switch = gui.add_checkbox(info.title, value is not None, hint=hint)
            self._switch.on_update(self._updated)
        first = _first_value(info) if value is None else value
        self._handles = _handles_of(gui, info, first, is_visible=value is not None)
        for each in self._handles:
            each.on_update(self._updated)

    @property
    def first(self) -> Any:
        """The first control, after that which switches it."""
        return self._handles[0]

    def display(self, value: Any) -> None:
        """Set the controls; viser calls back without a client, which `_updated` ignores."""
        if self._switch is not None:
            self._switch.value = value is not None
        self._show_handles()
        if value is not None:
            for each, part in zip(self._handles, _parts(self._info, value), strict=True):
                if isinstance(part, int | float) and hasattr(each, "max"):  # a slider's scale leaves out rare values
                    each.max = max(each.max, part)
                each.value = part

    def _updated(self, event: Any) -> None:
        if event.client is None:
            return
        self._show_handles()
        is_none = self._switch is not None and not self._switch.value
        value = None if is_none else _value(self._info, [each.value for each in self._handles])
        if isinstance(value, str) and value not in self._handles[0].options:  # such as a path of this machine
            return
        self._on_change(self._info, value, event.client)

    def _show_handles(self) -> None:
        if self._switch is not None:
            for each in self._handles:
                each.visible = self._switch.value


def _handles_of(gui: Any, info: Field, value: Any, *, is_visible: bool) -> _Handles:
    """Add the controls of a setting's type."""
    common: dict[str, Any] = {"hint": info.help, "visible": is_visible}
    if info.kind is bool:
        return [gui.add_checkbox(info.title, value, **common)]
    if info.choices or info.kind is str:
        return [gui.add_dropdown(info.label, _choices(info, value), initial_value=value, **common)]
    if info.kind is RegionBox:
        words = [f"{info.title}, {word} (m)" for word in ("from", "to")]
        corners = zip(words, _parts(info, value), strict=True)
        return [gui.add_vector3(word, corner, step=0.1, **common) for word, corner in corners]
    if info.name == "drop_color":
        return [gui.add_rgb(info.label, *_parts(info, value), **common)]
    if isinstance(value, tuple):
        low, high = ((bound,) * 2 for bound in info.bounds)
        return [gui.add_vector2(info.label, value, min=low, max=high, step=0.1, **common)]
    if info.kind is int and info.high > 1e6:
        return [gui.add_number(info.label, value, min=info.low, max=info.high, step=1, **common)]
    if info.is_logarithmic or info.name == "exposure_s":
        return [gui.add_number(info.label, value, min=info.low, max=info.high, **common)]
    high = max(info.slider_high, value)
    step = 1 if info.kind is int else 10.0 ** math.floor(math.log10((high - info.low) / _STEPS))
    return [gui.add_slider(info.label, info.low, high, step, value, **common)]


def _choices(info: Field, value: Any) -> tuple[str, ...]:
    """Words of a choice, or the shipped names; no name of a file that a browser would open."""
    names = info.choices or tuple(sensor_names() if info.name == "sensor" else LAMP_WORDS)
    return names if value in names else (*names, value)


def _first_value(info: Field) -> Any:
    """Value of a setting when it is switched on."""
    return _INITIAL.get(info.name, info.initial)


def _parts(info: Field, value: Any) -> list[Any]:
    """Value of each control of a setting."""
    if info.kind is RegionBox:
        return [value.minimum_m, value.maximum_m]
    if info.name == "drop_color":
        return [tuple(round(255 * min(max(each, 0.0), 1.0)) for each in value)]
    return [value]


def _value(info: Field, parts: list[Any]) -> Any:
    """Setting whose controls have these values."""
    if info.kind is RegionBox:
        return {"minimum_m": list(parts[0]), "maximum_m": list(parts[1])}
    if info.name == "drop_color":
        return [each / 255 for each in parts[0]]
    return parts[0]
