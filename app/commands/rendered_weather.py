"""Which weather `gsrain render` takes: the scene's own, less what the options set for the whole clip."""

from gsrain_engine.rain.weather import Weather
from gsrain_engine.scene.scene import Scene
from gsrain_engine.untrusted.explained_errors import converted

from .render_options import RainOptions


def rendered_weather(options: RainOptions | None, scene: Scene) -> Weather | None:
    """Return the weather saved with a scene; --rain and --exposure replace its keys of these, --preset all of it.

    Raises `msgspec.ValidationError` where what was saved can't be used.
    """
    if scene.weather is None or (options is not None and options.preset is not None):
        return None
    weather = converted(scene.weather, Weather)
    if options is not None and options.rain is not None:
        weather = weather.without("intensity_mm_h")
    if options is not None and options.exposure is not None:
        weather = weather.without("exposure_s")
    return weather
