"""Shows how to fit a calibration of the rain to drop spectra.

    python examples/02_calibrate.py [OUT] [FILE...]

FILE is a disdrometer's: Parsivel, Thies LNM, Joss-Waldvogel, 2DVD. Without one, the spectra come from simulated drops
(see 03), and the fit should recover the law from which they were drawn.
"""

import sys
from pathlib import Path

import numpy as np

from gsrain import RainSettings
from gsrain_engine.disdrometer.fit import calibrate
from gsrain_engine.disdrometer.fit_plot import write_plot
from gsrain_engine.disdrometer.netcdf import write_spectra
from gsrain_engine.disdrometer.virtual import VirtualDisdrometer
from gsrain_engine.rain.calibration import load_calibration, save_calibration
from gsrain_engine.rain.simulation import RainSimulation

out = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
out.mkdir(parents=True, exist_ok=True)
files = [Path(name) for name in sys.argv[2:]]
minutes_s = np.arange(0.0, 181.0, 60.0)

if not files:
    for intensity_mm_h in (1.2, 4.0, 8.5, 12.0):
        rainfall = RainSimulation.start(RainSettings(intensity_mm_h=intensity_mm_h, turbulence_m_s=0.0))
        files.append(out / f"spectra_{intensity_mm_h:g}mm_h.nc")
        write_spectra(files[-1], VirtualDisdrometer(rainfall).measure(minutes_s).spectra)

fitted = calibrate(files, name="example")
save_calibration(fitted.calibration, out / "calibration.yaml")  # Rain(calibration="out/calibration.yaml") uses it
write_plot(fitted, out / "calibration.png")
for calibration in (load_calibration("published"), fitted.calibration):
    for intensity_mm_h in (1.2, 8.5):
        state = RainSimulation.start(RainSettings(intensity_mm_h=intensity_mm_h, turbulence_m_s=0.0), calibration).state
        drops = f"{state.density_m3:5.0f} drops/m3, {state.mean_diameter_mm:.3f} mm on average"
        print(f"{calibration.name:>9} at {intensity_mm_h:g} mm/h: {drops}")
