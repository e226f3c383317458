"""Settings of the wet look."""

from typing import Annotated

from msgspec import Meta

from ...settings import Settings


class WetSettings(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Parameters of the wet look. The default is steady rain at noon."""

    wetness: Annotated[float, Meta(ge=0, le=1, title="Wetness")] = 1.0
    """Strength of the whole look; 0 changes nothing."""
    exposure_ev: Annotated[float, Meta(ge=-2, le=2, title="Exposure", extra={"unit": "EV"})] = 0.0
    """Brightness of the rainy day, in stops relative to automatic exposure."""
    sun_removal: Annotated[float, Meta(ge=0, le=1, title="Sun removal")] = 0.9
    """Share of the contrast between sun and cast shadow that is removed."""
    coolness: Annotated[float, Meta(ge=0, le=2, title="Coolness")] = 1.0
    """Blueness of overcast daylight; 0 is neutral gray."""
    sky_brightness: Annotated[float, Meta(ge=0.3, le=1, title="Sky brightness")] = 0.9
    """Display brightness of the clouds at the horizon."""
    clouds: Annotated[float, Meta(ge=0, le=1, title="Cloud structure")] = 0.4
    """Contrast of the cloud deck; 0 is uniform gray."""
    darkening: Annotated[float, Meta(ge=0, le=1, title="Darkening")] = 1.0
    """Share of the darkening of porous surfaces by water."""
    streaks: Annotated[float, Meta(ge=0, le=1, title="Streaks on walls")] = 0.5
    """Contrast of the streaks of water on walls."""
    gloss: Annotated[float, Meta(ge=0, le=1, title="Gloss of wet paint")] = 0.8
    """Share of the clouds' Fresnel reflection on wet vehicles."""
    lamps: Annotated[float, Meta(ge=0, le=2, title="Glow of lamps")] = 1.0
    """Glow around lamps and lit signs; 1 matches a lens with a little water on it."""
    tail_lamps: Annotated[bool, Meta(title="Tail lamps lit")] = True
    """Light the red lamps of vehicles, as drivers do in rain."""
    mist_km: Annotated[float, Meta(ge=0, le=20, title="Mist", extra={"unit": "1/km"})] = 0.0
    """Extinction of the air. The rain's own haze is added to it, so that more than 0 is a veil of both."""
    seed: Annotated[int, Meta(ge=0, le=2**31 - 1, title="Seed")] = 0
    """Seed of clouds, puddles and streaks."""
