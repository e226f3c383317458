from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr

from gsrain_engine.disdrometer import open
from gsrain_engine.disdrometer.instruments import PARSIVEL_DIAMETER_EDGES_MM, PARSIVEL_VELOCITY_EDGES_M_S
from gsrain_engine.disdrometer.netcdf import record_layout
from gsrain_engine.disdrometer.open import read_disdrometer
from gsrain_engine.disdrometer.spectra import DisdrometerFileError
from parsivel_text import DRY, RAIN_MM_H, rain

MIDDLES_MM = 0.5 * (PARSIVEL_DIAMETER_EDGES_MM[:-1] + PARSIVEL_DIAMETER_EDGES_MM[1:])
MIDDLES_M_S = 0.5 * (PARSIVEL_VELOCITY_EDGES_M_S[:-1] + PARSIVEL_VELOCITY_EDGES_M_S[1:])
TIMES = np.array(["2024-05-01T00:01", "2024-05-01T00:02", "2024-05-01T00:03"], "M8[ns]")


def spectra_dataset(counts: np.ndarray | None = None, rate: tuple[str, float] = ("mm h-1", 1.0)) -> xr.Dataset:
    """Two minutes of rain, one dry, as Cloudnet and disdrodb name things."""
    unit, factor = rate
    return xr.Dataset(
        {
            "data_raw": (
                ("time", "diameter", "velocity"),
                np.stack([rain(), DRY, rain()]) if counts is None else counts,
            ),
            "rainfall_rate": ("time", np.array([0.77, 0, 0.77]) * factor, {"units": unit}),
        },
        coords={
            "time": TIMES,
            "diameter": ("diameter", MIDDLES_MM / 1000, {"units": "m"}),
            "velocity": ("velocity", MIDDLES_M_S, {"units": "m s-1"}),
        },
    )


def refusal(path: Path) -> str:
    with pytest.raises(DisdrometerFileError) as caught:
        read_disdrometer(path)
    return str(caught.value).removeprefix(f"{path}: ")


@pytest.mark.parametrize("engine", ["h5netcdf", "scipy"])
def test_spectra(tmp_path: Path, engine: str):
    path = tmp_path / "file"
    spectra_dataset(rate=("m s-1", 1 / 3.6e6)).to_netcdf(path, engine=engine)
    reading = read_disdrometer(path)
    np.testing.assert_array_equal(reading.spectra.counts, [rain(), DRY, rain()])
    np.testing.assert_array_equal(reading.spectra.times, TIMES.astype("M8[ms]"))
    np.testing.assert_array_equal(reading.spectra.seconds, [60, 60, 60])
    np.testing.assert_allclose(reading.spectra.reported_mm_h, [0.77, 0, 0.77])
    np.testing.assert_allclose(reading.spectra.rate_mm_h[0], RAIN_MM_H, rtol=1e-4)
    assert reading.skipped == ()


def test_dimensions_in_another_order(tmp_path: Path):
    path = tmp_path / "file.nc"
    spectra_dataset().transpose("velocity", "time", "diameter").to_netcdf(path, engine="h5netcdf")
    np.testing.assert_array_equal(read_disdrometer(path).spectra.counts[0], rain())


def test_numbers_that_run_otherwise_than_their_dimensions_say(tmp_path: Path):
    path = tmp_path / "file.nc"
    spectra_dataset(np.stack([rain().T, DRY, rain().T])).to_netcdf(path, engine="h5netcdf")
    np.testing.assert_array_equal(read_disdrometer(path).spectra.counts[0], rain())


def test_dimensions_told_by_their_units_and_a_stated_interval(tmp_path: Path):
    path = tmp_path / "file.nc"
    dataset = spectra_dataset().rename(diameter="row", velocity="column")
    dataset["interval"] = ("time", np.array([3600.0, 3601.0, np.nan]), {"units": "s"})
    dataset.to_netcdf(path, engine="h5netcdf")
    spectra = read_disdrometer(path).spectra
    np.testing.assert_array_equal(spectra.counts[0], rain())
    np.testing.assert_array_equal(spectra.seconds, [3600, 60, 60])  # an hour at most


def test_missing_counts_skip_their_record(tmp_path: Path):
    path = tmp_path / "file.nc"
    counts = np.stack([rain(), DRY, rain()]).astype(float)
    counts[1, :2, 0] = np.nan
    spectra_dataset(counts).to_netcdf(path, engine="h5netcdf")
    reading = read_disdrometer(path)
    assert len(reading.spectra) == 2
    reason = "2 of 1024 drop counts are missing, negative or beyond any rain"
    assert reading.skipped == (f"record 2 (2024-05-01T00:02:00.000): {reason}",)
    spectra_dataset(np.full_like(counts, np.nan)).to_netcdf(path, engine="h5netcdf")
    assert refusal(path).startswith("no record can be used: record 1 (2024-05-01T00:01:00.000): 1024 of 1024")


def test_files_without_spectra_or_of_unknown_instruments(tmp_path: Path):
    path = tmp_path / "file.nc"
    xr.Dataset({"rain": ("time", [1.0, 2.0])}).to_netcdf(path, engine="h5netcdf")
    assert refusal(path).startswith(
        "no variable has the dimensions time, diameter and fall speed (it has rain, ...); known are OTT Parsivel ("
    )
    spectra_dataset().isel(diameter=slice(20)).to_netcdf(path, engine="h5netcdf")
    assert refusal(path).startswith("data_raw has 20 diameters and 32 fall speeds: of no instrument")
    dataset = spectra_dataset()
    dataset.assign_coords(diameter=(2 * dataset.diameter).assign_attrs(units="m")).to_netcdf(path, engine="h5netcdf")
    assert "with other bounds than it has" in refusal(path)


def drops_dataset() -> xr.Dataset:
    """Five drops: two in the first minute, none in the second, one in the third, and two that are no drops."""
    seconds = np.array([10, 50, 130, 131, 132], "m8[s]")
    return xr.Dataset(
        {
            "equivolumetric_sphere_diameter": ("time", [1.1, 1.1, 2.1, np.nan, 1.1]),
            "fall_speed": ("time", [4.2, 4.3, 6.6, 4.0, -1.0]),
            "oblateness": ("time", [0.95, np.nan, 0.88, 1.0, 1.0]),
            "area": ("time", [9000.0, 11000.0, 10500.0, 10000.0, 10000.0]),
        },
        coords={"time": np.datetime64("2018-12-14T02:08:00", "ns") + seconds},
    )


def test_single_drops(tmp_path: Path):
    path = tmp_path / "file.cdf"
    drops_dataset().to_netcdf(path, engine="scipy", unlimited_dims="time")
    reading = read_disdrometer(path)
    drops, spectra = reading.drops, reading.spectra
    assert drops is not None and len(drops) == 3
    np.testing.assert_allclose(drops.diameters_mm, [1.1, 1.1, 2.1])
    np.testing.assert_allclose(drops.speeds_m_s, [4.2, 4.3, 6.6])
    np.testing.assert_array_equal(drops.axis_ratios, [0.95, np.nan, 0.88])
    assert drops.times[0] == np.datetime64("2018-12-14T02:08:10")
    np.testing.assert_array_equal(spectra.counts.sum(axis=(1, 2)), [2, 0, 1])
    assert spectra.counts[0, 5, 8] == 2 and spectra.counts[2, 10, 13] == 1
    np.testing.assert_allclose(spectra.area_m2[[5, 10]], [0.01, 0.0105])
    assert spectra.times[0] == np.datetime64("2018-12-14T02:09")
    assert [each.split(" (")[0] for each in reading.skipped] == ["drop 4", "drop 5"]
    assert "its diameter in mm is nan" in reading.skipped[0] and "its speed in m/s is -1.0" in reading.skipped[1]


def joss_waldvogel_dataset(middles: list[float], widths: list[float]) -> xr.Dataset:
    return xr.Dataset(
        {
            "num_drop": (("time", "drop_class"), [[10.0, 5.0], [0.0, 0.0]]),
            "mean_diam_drop_class": ("drop_class", middles),
            "delta_diam": ("drop_class", widths),
            "rain_rate": ("time", [0.03, -9999.0], {"units": "mm/hr"}),
        },
        coords={"time": TIMES[:2]},
    )


@pytest.mark.parametrize(
    ("middles", "widths"), [([0.359, 12.0], [0.092, 20.0]), ([0.359, 0.3], [0.092, -0.1]), ([0.01, 0.1], [0.1, 0.1])]
)
def test_classes_of_a_joss_waldvogel_that_no_drop_has(tmp_path: Path, middles: list[float], widths: list[float]):
    path = tmp_path / "file.cdf"
    joss_waldvogel_dataset(middles, widths).to_netcdf(path, engine="scipy")
    assert refusal(path) == "delta_diam: the diameter classes must rise within 0 to 20 mm"


def test_joss_waldvogel(tmp_path: Path):
    path = tmp_path / "file.cdf"
    joss_waldvogel_dataset([0.359, 0.455], [0.092, 0.1]).to_netcdf(path, engine="scipy")
    spectra = read_disdrometer(path).spectra
    assert spectra.velocity_edges_m_s is None
    np.testing.assert_allclose(spectra.diameter_edges_mm, [0.313, 0.405, 0.505])
    np.testing.assert_allclose(spectra.rate_mm_h[0], np.pi / 6 * (10 * 0.359**3 + 5 * 0.455**3) / 5000 * 60)
    np.testing.assert_array_equal(spectra.reported_mm_h, [0.03, np.nan])


def test_a_classic_file_that_ends_too_early_keeps_its_whole_records(tmp_path: Path):
    path = tmp_path / "file.nc"
    spectra_dataset().to_netcdf(path, engine="scipy", unlimited_dims="time")
    data = path.read_bytes()
    layout = record_layout(data)
    assert layout.start + layout.written * layout.size == len(data)
    path.write_bytes(data[: layout.start + 2 * layout.size + 7])
    reading = read_disdrometer(path)
    np.testing.assert_array_equal(reading.spectra.counts, [rain(), DRY])
    assert reading.skipped == ("record 3: the file ends in it, and 0 more are missing",)
    path.write_bytes(data[: layout.start + 7])
    assert refusal(path).startswith("no record can be used: record 1: the file ends in it, and 2 more are missing")


@pytest.mark.parametrize("engine", ["h5netcdf", "scipy"])
def test_damaged_files_are_refused(tmp_path: Path, engine: str):
    path = tmp_path / "file.nc"
    spectra_dataset().to_netcdf(path, engine=engine)
    data = path.read_bytes()
    for size in (8, 30, 100, len(data) // 2):
        path.write_bytes(data[:size])
        assert "damaged or cut off" in refusal(path)


def test_size_is_checked_before_anything_is_unpacked(tmp_path: Path):
    path = tmp_path / "bomb.nc"
    with h5py.File(path, "w") as file:
        file.create_dataset("time", (2**40,), "f8", chunks=(2**20,), compression="gzip")
    assert path.stat().st_size < 10_000
    assert refusal(path) == f"it holds more than {open.LARGEST_DATASET // 2**20} MiB: split it by days"


def disdrodb_dataset(product: str = "L1", sensor: str = "PARSIVEL", seconds: int = 60) -> xr.Dataset:
    """A product as DISDRODB writes it: a Parsivel's classes without the first two and those beyond 10 mm or 10 m/s."""
    rows, columns = slice(2, 25), slice(0, 26)
    shift = 0.0005  # of DISDRODB's bounds
    lower, upper = PARSIVEL_DIAMETER_EDGES_MM[:-1][rows] - shift, PARSIVEL_DIAMETER_EDGES_MM[1:][rows] - shift
    slow, fast = PARSIVEL_VELOCITY_EDGES_M_S[:-1][columns], PARSIVEL_VELOCITY_EDGES_M_S[1:][columns]
    diameter, velocity = "diameter_bin_center", "velocity_bin_center"
    return xr.Dataset(
        {
            "raw_drop_number": (
                ("time", diameter, velocity),
                np.stack([rain(), DRY, rain()])[:, rows, columns].astype("f4"),
            ),
            "drop_number": (("time", diameter, velocity), np.zeros((3, len(lower), len(slow)), "f4")),
            "drop_number_concentration": (("time", diameter, "velocity_method"), np.ones((3, len(lower), 2))),
            "R": (("time", "velocity_method"), np.ones((3, 2)), {"units": "mm h-1"}),
            "sample_interval": ((), seconds, {"units": "seconds"}),
        },
        coords={
            "time": TIMES,
            diameter: (diameter, 0.5 * (lower + upper), {"units": "mm"}),
            velocity: (velocity, 0.5 * (slow + fast), {"units": "m/s"}),
            "diameter_bin_lower": (diameter, lower),
            "diameter_bin_upper": (diameter, upper, {"units": "mm"}),
            "velocity_bin_lower": (velocity, slow, {"units": "m/s"}),
            "velocity_bin_upper": (velocity, fast, {"units": "m/s"}),
        },
        attrs={"disdrodb_product": product, "sensor_name": sensor, "disdrodb_rolled_product": "False"},
    )


def test_disdrodb_products_have_their_classes_put_back(tmp_path: Path):
    path = tmp_path / "L2E.nc"
    disdrodb_dataset("L2E").to_netcdf(path, engine="h5netcdf")
    spectra = read_disdrometer(path).spectra
    assert spectra.instrument == "OTT Parsivel"
    np.testing.assert_array_equal(spectra.diameter_edges_mm, PARSIVEL_DIAMETER_EDGES_MM)
    np.testing.assert_array_equal(spectra.counts, [rain(), DRY, rain()])
    np.testing.assert_allclose(spectra.rate_mm_h, [RAIN_MM_H, 0, RAIN_MM_H], rtol=1e-4)
    assert np.isnan(spectra.reported_mm_h).all()  # theirs follow from the drops


def test_sums_that_roll_on_count_each_drop_once(tmp_path: Path):
    path = tmp_path / "L1.nc"
    dataset = disdrodb_dataset(seconds=120)
    dataset.attrs["disdrodb_rolled_product"] = "True"
    dataset.to_netcdf(path, engine="h5netcdf")
    reading = read_disdrometer(path)
    np.testing.assert_array_equal(reading.spectra.times, TIMES[[0, 2]].astype("M8[ms]"))
    assert reading.skipped == ("record 2 (2024-05-01T00:02:00.000): it overlaps the one before (sums that roll on)",)


def test_a_sensor_with_classes_of_its_own(tmp_path: Path):
    path = tmp_path / "L1.nc"
    disdrodb_dataset(sensor="PWS100").to_netcdf(path, engine="h5netcdf")
    spectra = read_disdrometer(path).spectra
    assert spectra.instrument == "Campbell PWS100"
    np.testing.assert_array_equal(spectra.counts, np.stack([rain(), DRY, rain()])[:, 2:25, :26])
    np.testing.assert_allclose(spectra.velocity_edges_m_s, PARSIVEL_VELOCITY_EDGES_M_S[:27])
    np.testing.assert_array_equal(spectra.area_m2, 0.004)


def test_a_sensor_without_fall_speeds(tmp_path: Path):
    path = tmp_path / "L1.nc"
    whole = disdrodb_dataset(sensor="RD80").drop_vars("drop_number")
    counts = whole["raw_drop_number"].sum("velocity_bin_center")
    whole.assign(raw_drop_number=counts).to_netcdf(path, engine="h5netcdf")
    spectra = read_disdrometer(path).spectra
    assert spectra.instrument == "Joss-Waldvogel" and spectra.velocity_edges_m_s is None
    np.testing.assert_array_equal(spectra.counts[0, :, 0], rain()[2:25].sum(axis=1))
    np.testing.assert_array_equal(spectra.area_m2, 0.005)
    np.testing.assert_allclose(spectra.diameter_edges_mm[[0, -1]], [0.2495, 9.9995])


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (
            lambda each: each.assign_attrs(sensor_name="PLUVIO"),
            "sensor_name PLUVIO is none whose area is known (PARSIVEL,",
        ),
        (
            lambda each: each.assign_attrs(sensor_name="LPM"),
            "diameter_bin_lower: its classes are not those of the sensor",
        ),
        (
            lambda each: each.assign_coords(
                {f"diameter_bin_{end}": each[f"diameter_bin_{end}"] + 0.05 for end in ("lower", "upper")}
            ),
            "diameter_bin_lower: its classes are not those of the sensor",
        ),
        (lambda each: each.drop_vars("velocity_bin_lower"), "velocity_bin_lower is missing: the bounds of the classes"),
        (
            lambda each: each.assign_coords(diameter_bin_lower=-each.diameter_bin_lower),
            "diameter_bin_lower and diameter_bin_upper must rise within 0 to 50",
        ),
        (
            lambda each: each.assign_coords(diameter_bin_upper=each.diameter_bin_upper + 0.2),
            "diameter_bin_upper: each class must end where the next begins",
        ),
        (
            lambda each: each.assign_coords(velocity_bin_upper=each.velocity_bin_upper.assign_attrs(units="knots")),
            "velocity_bin_upper is in knots, not in mm or m/s",
        ),
        (lambda each: each * np.nan, "no record can be used: record 1 (2024-05-01T00:01:00.000): 598 of 598 drop"),
        (lambda each: each.isel(time=slice(0)), "it holds no record"),
        (
            lambda each: each.rename(velocity_bin_center="speed"),
            "raw_drop_number has the dimensions time, diameter_bin_center, speed, not time, diameter_bin_center",
        ),
    ],
)
def test_damaged_disdrodb_products_are_refused(tmp_path: Path, change, reason: str):
    path = tmp_path / "L1.nc"
    with xr.set_options(keep_attrs=True):
        change(disdrodb_dataset()).to_netcdf(path, engine="h5netcdf")
    assert refusal(path).startswith(reason)


def two_dvd_minutes() -> xr.Dataset:
    counts = np.zeros((3, 50))
    counts[0, 5] = 40
    return xr.Dataset(
        {
            "num_drops": (("time", "drop_diameter"), counts),
            "rain_rate": ("time", [0.167, 0, np.nan], {"units": "mm/hr"}),
        },
        coords={"time": TIMES, "drop_diameter": ("drop_diameter", 0.1 + 0.2 * np.arange(50), {"units": "mm"})},
    )


def test_minutes_of_arms_2dvd(tmp_path: Path):
    path, minutes = tmp_path / "vdis.cdf", two_dvd_minutes()
    minutes.to_netcdf(path, engine="scipy")
    spectra = read_disdrometer(path).spectra
    assert spectra.instrument == "2DVD" and spectra.velocity_edges_m_s is None
    np.testing.assert_allclose(spectra.rate_mm_h[0], np.pi / 6 * 1.1**3 * 40 / 10_000 * 60)
    np.testing.assert_allclose(spectra.reported_mm_h, [0.167, 0, np.nan])
    minutes.assign_coords(drop_diameter=2 * minutes.drop_diameter).to_netcdf(tmp_path / "other.cdf", engine="scipy")
    assert refusal(tmp_path / "other.cdf").startswith("drop_diameter: a 2DVD has 50 classes of 0.2 mm")
