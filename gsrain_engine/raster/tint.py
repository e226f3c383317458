"""The colour that selected splats are tinted with; common_tint.glsl's twin."""

TINT = (1.0, 0.82, 0.15)
"""Display colour: a warm yellow, which hardly any street has."""

TINT_SHARE = 0.5
"""How much of a selected splat's colour it is."""
