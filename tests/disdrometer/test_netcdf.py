"""NetCDF files: GSRAIN's own, those of Cloudnet, ARM and DISDRODB; whole, damaged and cut off."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
import xarray as xr

from gsrain_engine.disdrometer import netcdf
from gsrain_engine.disdrometer.instruments import PARSIVEL
from gsrain_engine.disdrometer.netcdf import record_layout, write_spectra
from gsrain_engine.disdrometer.open import read_disdrometer
from gsrain_engine.disdrometer.spectra import DisdrometerFileError, DropSpectra
from measured_rain import measured_rain
from parsivel_text import DRY, RAIN_MM_H, rain

EDGES_MM, EDGES_M_S = PARSIVEL.diameter_edges_mm, PARSIVEL.velocity_edges_m_s
MIDDLES_MM, MIDDLES_M_S = 0.5 * (EDGES_MM[:-1] + EDGES_MM[1:]), 0.5 * (EDGES_M_S[:-1] + EDGES_M_S[1:])
TIMES = np.array(["2024-05-01T00:01", "2024-05-01T00:02", "2024-05-01T00:03"], "M8[ns]")
COUNTS = np.stack([rain(), DRY, rain()])


def cloudnet(counts=COUNTS, unit="mm h-1", factor=1.0):
    """Two minutes of rain, one dry, as Cloudnet names things."""
    return xr.Dataset(
        {
            "data_raw": (("time", "diameter", "velocity"), counts),
            "rainfall_rate": ("time", np.array([0.77, 0, 0.77]) * factor, {"units": unit}),
        },
        coords={
            "time": TIMES,
            "diameter": ("diameter", MIDDLES_MM / 1000, {"units": "m"}),
            "velocity": ("velocity", MIDDLES_M_S, {"units": "m s-1"}),
        },
    )


def disdrodb(product="L1", sensor="PARSIVEL", seconds=60):
    """A product as DISDRODB writes it: a Parsivel's classes without the first two and those beyond 10 mm or 10 m/s."""
    lower, upper = EDGES_MM[2:25] - 0.0005, EDGES_MM[3:26] - 0.0005  # DISDRODB's bounds
    slow, fast = EDGES_M_S[:26], EDGES_M_S[1:27]
    diameter, velocity = "diameter_bin_center", "velocity_bin_center"
    return xr.Dataset(
        {
            "raw_drop_number": (("time", diameter, velocity), COUNTS[:, 2:25, :26].astype("f4")),
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


def joss_waldvogel(middles=(0.359, 0.455), widths=(0.092, 0.1)):
    return xr.Dataset(
        {
            "num_drop": (("time", "drop_class"), [[10.0, 5.0], [0.0, 0.0]]),
            "mean_diam_drop_class": ("drop_class", list(middles)),
            "delta_diam": ("drop_class", list(widths)),
            "rain_rate": ("time", [0.03, -9999.0], {"units": "mm/hr"}),
        },
        coords={"time": TIMES[:2]},
    )


def two_dvd_minutes(scale=1.0):
    counts = np.zeros((3, 50))
    counts[0, 5] = 40
    diameters = ("drop_diameter", scale * (0.1 + 0.2 * np.arange(50)), {"units": "mm"})
    return xr.Dataset(
        {
            "num_drops": (("time", "drop_diameter"), counts),
            "rain_rate": ("time", [0.167, 0, np.nan], {"units": "mm/hr"}),
        },
        coords={"time": TIMES, "drop_diameter": diameters},
    )


def two_dvd_drops():
    """Five drops: two in the first minute, none in the second, one in the third, and two that are no drops."""
    return xr.Dataset(
        {
            "equivolumetric_sphere_diameter": ("time", [1.1, 1.1, 2.1, np.nan, 1.1]),
            "fall_speed": ("time", [4.2, 4.3, 6.6, 4.0, -1.0]),
            "oblateness": ("time", [0.95, np.nan, 0.88, 1.0, 1.0]),
            "area": ("time", [9000.0, 11000.0, 10500.0, 10000.0, 10000.0]),
        },
        coords={"time": np.datetime64("2018-12-14T02:08:00", "ns") + np.array([10, 50, 130, 131, 132], "m8[s]")},
    )


@pytest.fixture
def read(tmp_path):
    """Write a data set and read it back."""

    def write_and_read(dataset, engine="scipy"):
        dataset.to_netcdf(tmp_path / "file.nc", engine=engine)
        return read_disdrometer(tmp_path / "file.nc")

    return write_and_read


@pytest.mark.parametrize("has_speeds", [True, False])
def test_our_own_files_come_back_and_are_checked(has_speeds, read, tmp_path):
    spectra = measured_rain(271.0, 9.705, 0.074, minutes=2, seed=1)
    if not has_speeds:
        spectra = replace(spectra, counts=spectra.counts.sum(axis=2, keepdims=True), velocity_edges_m_s=None)
    write_spectra(tmp_path / "own.nc", spectra)
    found = read_disdrometer(tmp_path / "own.nc").spectra
    for name in DropSpectra.__slots__:
        np.testing.assert_array_equal(getattr(found, name), getattr(spectra, name), err_msg=name)
    with xr.open_dataset(tmp_path / "own.nc", engine="h5netcdf", decode_times=False) as file:
        file = file.load()
    bounds = file.diameter_bounds
    for name, change in {
        "gsrain_drop_spectra": file.assign_attrs(gsrain_drop_spectra=2),
        "area": file.drop_vars("area"),
        "drops": file.assign(drops=-file.drops - 1),
        "diameter_bounds": file.assign(diameter_bounds=(bounds.dims, bounds.data[::-1])),
    }.items():
        with pytest.raises(DisdrometerFileError, match=f"file.nc: {name} "):
            read(change)


@pytest.mark.parametrize("engine", ["h5netcdf", "scipy"])
@pytest.mark.parametrize(
    "change",
    [
        lambda each: each.transpose("velocity", "time", "diameter"),
        lambda each: each.assign(data_raw=each.data_raw.copy(data=COUNTS.transpose(0, 2, 1))),  # dimensions swapped
        lambda each: each.rename(diameter="row", velocity="column"),  # only units tell them apart
        lambda each: each.isel(time=[2, 1, 0]),
    ],
)
def test_spectra_of_both_kinds_of_netcdf_have_their_dimensions_in_any_order(change, engine, read):
    reading = read(change(cloudnet(unit="m s-1", factor=1 / 3.6e6)), engine)
    np.testing.assert_array_equal(reading.spectra.counts, COUNTS)
    np.testing.assert_array_equal(reading.spectra.times, TIMES.astype("M8[ms]"))
    np.testing.assert_array_equal(reading.spectra.seconds, [60, 60, 60])
    np.testing.assert_allclose(reading.spectra.reported_mm_h, [0.77, 0, 0.77])
    np.testing.assert_allclose(reading.spectra.rate_mm_h[0], RAIN_MM_H, rtol=1e-4)
    assert reading.skipped == ()


def test_missing_counts_skip_their_record_and_an_interval_is_limited_to_an_hour(read):
    counts = COUNTS.astype(float)
    counts[1, :2, 0] = np.nan
    dataset = cloudnet(counts)
    dataset["interval"] = ("time", np.array([3600.0, 60.0, 3601.0]), {"units": "s"})
    reading = read(dataset)
    np.testing.assert_array_equal(reading.spectra.seconds, [3600, 60])
    assert [each.partition(" are")[0] for each in reading.skipped] == [
        "record 2 (2024-05-01T00:02:00.000): 2 of 1024 drop counts"
    ]


def test_single_drops_of_a_2dvd_are_counted_by_minute(read):
    reading = read(two_dvd_drops())
    drops, spectra = reading.drops, reading.spectra
    np.testing.assert_allclose(drops.diameters_mm, [1.1, 1.1, 2.1])
    np.testing.assert_allclose(drops.speeds_m_s, [4.2, 4.3, 6.6])
    np.testing.assert_array_equal(drops.axis_ratios, [0.95, np.nan, 0.88])
    assert drops.times[0] == np.datetime64("2018-12-14T02:08:10")
    np.testing.assert_array_equal(spectra.counts.sum(axis=(1, 2)), [2, 0, 1])
    assert spectra.counts[0, 5, 8] == 2 and spectra.counts[2, 10, 13] == 1
    np.testing.assert_allclose(spectra.area_m2[[5, 10]], [0.01, 0.0105])
    assert spectra.times[0] == np.datetime64("2018-12-14T02:09")
    assert "diameter in mm is nan" in reading.skipped[0] and "speed in m/s is -1.0" in reading.skipped[1]


def test_drops_by_diameter_of_a_2dvd_and_a_joss_waldvogel(read):
    minutes = read(two_dvd_minutes()).spectra
    assert minutes.instrument == "2DVD" and minutes.velocity_edges_m_s is None
    np.testing.assert_allclose(minutes.rate_mm_h[0], np.pi / 6 * 1.1**3 * 40 / 10_000 * 60)
    np.testing.assert_allclose(minutes.reported_mm_h, [0.167, 0, np.nan])
    counted = read(joss_waldvogel()).spectra
    assert counted.instrument == "Joss-Waldvogel" and counted.velocity_edges_m_s is None
    np.testing.assert_allclose(counted.diameter_edges_mm, [0.313, 0.405, 0.505])
    np.testing.assert_allclose(counted.rate_mm_h[0], np.pi / 6 * (10 * 0.359**3 + 5 * 0.455**3) / 5000 * 60)
    np.testing.assert_array_equal(counted.reported_mm_h, [0.03, np.nan])


def test_disdrodb_products_have_their_classes_restored_and_rolling_sums_count_each_drop_once(read):
    spectra = read(disdrodb("L2E")).spectra
    assert spectra.instrument == "OTT Parsivel"
    np.testing.assert_array_equal(spectra.diameter_edges_mm, EDGES_MM)
    np.testing.assert_array_equal(spectra.counts, COUNTS)
    assert np.isnan(spectra.reported_mm_h).all()  # theirs follow from the drops
    rolling = read(disdrodb(seconds=120).assign_attrs(disdrodb_rolled_product="True"))
    np.testing.assert_array_equal(rolling.spectra.times, TIMES[[0, 2]].astype("M8[ms]"))
    assert [each.partition(" (")[0] for each in rolling.skipped] == ["record 2"]


def test_other_sensors_of_disdrodb(read):
    spectra = read(disdrodb(sensor="PWS100")).spectra
    assert spectra.instrument == "Campbell PWS100"
    np.testing.assert_array_equal(spectra.counts, COUNTS[:, 2:25, :26])
    np.testing.assert_allclose(spectra.velocity_edges_m_s, EDGES_M_S[:27])
    np.testing.assert_array_equal(spectra.area_m2, 0.004)
    whole = disdrodb(sensor="RD80").drop_vars("drop_number")
    spectra = read(whole.assign(raw_drop_number=whole["raw_drop_number"].sum("velocity_bin_center"))).spectra
    assert spectra.instrument == "Joss-Waldvogel" and spectra.velocity_edges_m_s is None
    np.testing.assert_array_equal(spectra.counts[:, :, 0], COUNTS[:, 2:25].sum(axis=2))
    np.testing.assert_array_equal(spectra.area_m2, 0.005)


def shifted(each, name, by):
    return each.assign_coords({name: (each[name] + by).assign_attrs(each[name].attrs)})


@pytest.mark.parametrize(
    ("dataset", "names"),
    [
        (xr.Dataset({"rain": ("time", [1.0, 2.0])}), r"\(it has rain, ...\)"),
        (cloudnet().isel(diameter=slice(20)), "data_raw has 20 diameters and 32 fall speeds"),
        (cloudnet().assign_coords(diameter=("diameter", MIDDLES_MM / 500, {"units": "m"})), "diameter has as many"),
        (cloudnet(np.full(COUNTS.shape, np.nan)), "record 1 .*and 2 more"),
        (cloudnet().isel(time=slice(0)), "no record"),
        (joss_waldvogel((0.359, 12.0), (0.092, 20.0)), "delta_diam"),
        (joss_waldvogel((0.359, 0.3), (0.092, -0.1)), "delta_diam"),
        (joss_waldvogel((0.01, 0.1), (0.1, 0.1)), "delta_diam"),
        (two_dvd_minutes(2.0), "drop_diameter"),
        (two_dvd_drops() * np.nan, "drop 1 "),
        (disdrodb(sensor="PLUVIO"), "sensor_name PLUVIO"),
        (disdrodb(sensor="LPM"), "diameter_bin_lower"),
        (disdrodb().drop_vars("velocity_bin_lower"), "velocity_bin_lower"),
        (shifted(disdrodb(), "diameter_bin_lower", -9.0), "diameter_bin_lower and diameter_bin_upper must rise"),
        (shifted(disdrodb(), "diameter_bin_upper", 0.2), "diameter_bin_upper"),
        (disdrodb().assign_coords(velocity_bin_upper=("velocity_bin_center", EDGES_M_S[1:27], {"units": "knots"})),
         "velocity_bin_upper is in knots"),
        (disdrodb().rename(velocity_bin_center="speed"), "raw_drop_number has the dimensions time, .*speed"),
    ],
)  # fmt: skip
def test_unusable_datasets_are_refused_by_name(dataset, names, read):
    with pytest.raises(DisdrometerFileError, match=f"file.nc: .*{names}"):
        read(dataset)


def test_a_classic_file_that_ends_too_early_keeps_its_whole_records(tmp_path):
    path = tmp_path / "file.nc"
    cloudnet().to_netcdf(path, engine="scipy", unlimited_dims=("time",))
    data = path.read_bytes()
    layout = record_layout(data)
    assert layout.start + layout.written * layout.size == len(data)
    path.write_bytes(data[: layout.start + 2 * layout.size + 7])
    reading = read_disdrometer(path)
    np.testing.assert_array_equal(reading.spectra.counts, [rain(), DRY])
    assert [each.partition(":")[0] for each in reading.skipped] == ["record 3"]
    path.write_bytes(data[: layout.start + 7])
    with pytest.raises(DisdrometerFileError, match="record 1: "):
        read_disdrometer(path)


@pytest.mark.parametrize("engine", ["h5netcdf", "scipy"])
def test_damaged_files_are_refused(engine, tmp_path):
    path = tmp_path / "file.nc"
    cloudnet().to_netcdf(path, engine=engine)
    data = path.read_bytes()
    for size in (8, 30, 100, len(data) // 2):
        path.write_bytes(data[:size])
        with pytest.raises(DisdrometerFileError, match="damaged or cut off"):
            read_disdrometer(path)


def test_size_is_checked_before_anything_is_unpacked(read, tmp_path, monkeypatch):
    with h5py.File(tmp_path / "bomb.nc", "w") as file:
        file.create_dataset("time", (2**40,), "f8", chunks=(2**20,), compression="gzip")
    with pytest.raises(DisdrometerFileError, match="more than 64 MiB, too many for"):
        read_disdrometer(tmp_path / "bomb.nc")
    monkeypatch.setattr(netcdf, "MAX_COUNTS", 2 * 1024)
    with pytest.raises(DisdrometerFileError, match="3 spectra"):
        read(cloudnet())
