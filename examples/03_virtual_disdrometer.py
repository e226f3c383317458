"""Shows that the simulated drops have the rain rate that was set: counts them through half a square meter.

    python examples/03_virtual_disdrometer.py [OUT]

closure="density" sets the drop density to match the intensity; "published" uses the paper's table, which contains less
water.
"""

import sys
from pathlib import Path

import numpy as np

from gsrain import RainSettings
from gsrain_engine.disdrometer.netcdf import write_spectra
from gsrain_engine.disdrometer.virtual import VirtualDisdrometer
from gsrain_engine.rain.simulation import RainSimulation

out = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
out.mkdir(parents=True, exist_ok=True)
minutes_s = np.arange(0.0, 121.0, 60.0)

for closure in ("density", "published"):
    for intensity_mm_h in (1.2, 8.5, 12.0):
        rain = RainSettings(
            intensity_mm_h=intensity_mm_h, closure=closure, turbulence_m_s=0.0
        )  # the table's fall speed
        rainfall = RainSimulation.start(rain)
        counted = VirtualDisdrometer(rainfall, area_m2=0.5).measure(minutes_s)
        measured = f"{counted.rate_mm_h:.3f} +- {counted.standard_error_mm_h:.3f} mm/h"
        print(f"{closure:9} {intensity_mm_h:4g} mm/h asked, {measured:>21} measured, {counted.drops:9,} drops counted")
        write_spectra(out / f"{closure}_{intensity_mm_h:g}mm_h.nc", counted.spectra)  # for xarray, or as input of 02
