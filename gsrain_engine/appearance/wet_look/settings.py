"""What a person can choose about the wet look."""

from typing import Annotated

from msgspec import Meta, Struct


class WetSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a clear view becomes one of a rainy day. The default is a steady rain at noon."""

    wetness: Annotated[float, Meta(ge=0, le=1, title="Wetness")] = 1.0
    """Share of the whole look; 0 changes nothing."""
    exposure_ev: Annotated[float, Meta(ge=-2, le=2, title="Exposure", extra={"unit": "EV"})] = 0.0
    """Brightness of the rainy day, in stops over what a camera would choose."""
    sun_removal: Annotated[float, Meta(ge=0, le=1, title="Sun removal")] = 0.9
    """Share of the contrast between sun and cast shadow that goes."""
    coolness: Annotated[float, Meta(ge=0, le=2, title="Coolness")] = 1.0
    """How blue daylight from cloud is; 0 is neutral grey."""
    sky_brightness: Annotated[float, Meta(ge=0.3, le=1, title="Sky brightness")] = 0.9
    """Display brightness of the cloud at the horizon."""
    clouds: Annotated[float, Meta(ge=0, le=1, title="Cloud structure")] = 0.4
    """Contrast of the cloud deck; 0 is an even grey."""
    darkening: Annotated[float, Meta(ge=0, le=1, title="Darkening")] = 1.0
    """Share of the darkening that water brings to porous surfaces."""
    streaks: Annotated[float, Meta(ge=0, le=1, title="Streaks on walls")] = 0.5
    """Contrast of where water runs down walls."""
    gloss: Annotated[float, Meta(ge=0, le=1, title="Gloss of wet paint")] = 0.8
    """Share of the cloud that wet vehicles mirror by Fresnel's law."""
    lamps: Annotated[float, Meta(ge=0, le=2, title="Glow of lamps")] = 1.0
    """Light around lamps and lit signs; 1 is a lens with a little water on it."""
    tail_lamps: Annotated[bool, Meta(title="Tail lamps lit")] = True
    """Whether red lamps of vehicles are lit, as drivers do in rain."""
    mist_km: Annotated[float, Meta(ge=0, le=20, title="Mist", extra={"unit": "1/km"})] = 0.8
    """Extinction of the air; rain's own haze comes on top."""
    seed: Annotated[int, Meta(ge=0, le=2**31 - 1, title="Seed")] = 0
    """Chooses clouds, puddles and streaks."""
