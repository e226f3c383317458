"""Calibrated rain in captured 3D Gaussian Splatting scenes, from Python: `import gsrain as gr`.

    scene = gr.load("street")
    rain = gr.Rain(intensity=8.5)
    gr.render(gr.wet(scene), rain).save("rain.png")

Lengths are in meters in a world with z up, times in seconds, intensities in mm/h. Values such as `Scene`, `Rain` and
`Camera` don't change: a function that edits one returns another. Bad input raises a `ValueError` of one sentence. A
name loads what it needs when it is first used; `__init__.pyi` lists all names.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
