"""Small Parsivel files for tests: rain of one spectrum, in the dialects that stations write."""

import re
from collections.abc import Sequence

import numpy as np

DRY = np.zeros((32, 32), int)
Row = tuple[str, str, np.ndarray]
"""Time as 2024-02-19 00:01:00, rain rate in mm/h, and counts by diameter and speed."""


def rain() -> np.ndarray:
    """Counts by diameter and speed of a minute of light rain: 14 classes, each at about its own fall speed."""
    counts = DRY.copy()
    for diameter, velocity, drops in ((3, 11, 20), (5, 15, 30), (7, 18, 25), (9, 20, 12), (11, 21, 6), (14, 22, 1)):
        counts[diameter, velocity] = drops
        counts[diameter, velocity + 1] = drops // 2
    return counts


RAIN_MM_H = 0.7719
"""Rain rate of those drops on the effective area."""


def velocity_major(counts: np.ndarray) -> list[str]:
    """The 1024 numbers as a Parsivel writes them."""
    return [f"{count:03d}" for count in counts.T.ravel()]


def station_line(second: int, counts: np.ndarray = DRY, rate: str = "0000.000", numbers: Sequence[str] = ()) -> str:
    """One line of a station's log, a minute long."""
    return _station(f"201904102307{second:02d}", rate, numbers or velocity_major(counts))


def _station(time: str, rate: str, numbers: Sequence[str]) -> str:
    head = [time, rate, "0000.50", "00", "-9.999", "20000", "00060", "18162", "00000", "-06"]
    head += ["413258", "2.10.1", "4.00", "24.1", "0", "NYA", "000.050", "000"]
    return ";".join([*head, *["-9.999"] * 32, *["00.000"] * 32, *numbers]) + ";"


def locarno_line(time: str, counts: np.ndarray = DRY, rate: str = "0000.000") -> str:
    """One line of Locarno's log, without a length."""
    fields = ["na", "OK", rate, "0000.02", "00", "00", "-9.999", "5000", "09893", "00000", "017", "0.04", "26.6", "0"]
    fields += ["000.002", "000", "-9.999," * 32, "00.000," * 32, ",".join(velocity_major(counts)) + ",", "0"]
    return f'610908,4610.3530,00847.2425,"{time}",' + ",".join(f'"{field}"' for field in fields)


# The dialects. Each writes the same records.


def _day(time: str, form: str) -> str:
    year, month, day = time[:10].split("-")
    return form.format(y=year, m=month, d=day)


def station(rows: list[Row]) -> list[str]:
    return [_station(re.sub(r"\D", "", time), rate, velocity_major(counts)) for time, rate, counts in rows]


def full(rows: list[Row]) -> list[str]:
    """Fields 01 to 30 of the telegram and the spectra; a clock that nobody set, and the logger's time at the end."""
    lines: list[str] = []
    for time, rate, counts in rows:
        head = [rate, "0005.90", "62", "63", "   RA", "   R", "20.902"]
        head += ["20000", "00060", "14279", "00080", "020", "304555", "2.00.6", "2.00.1", "0.16", "23.9", "0"]
        head += ["17:02:49 11.05.2015", "00:10:03", "28.11.2013", "", "", "000.590", "000", "00.537", "0000.5"]
        head += ["0005.90", "20.90", "0004.51"]
        lines.append(";".join([*head, *["-9.999"] * 32, *["00.000"] * 32, *velocity_major(counts), time, ""]))
    return lines


def locarno(rows: list[Row]) -> list[str]:
    return [locarno_line(_day(time, "{d}-{m}-{y}") + time[10:], counts, rate) for time, rate, counts in rows]


def spectrum(counts: np.ndarray, separator: str) -> str:
    """Counts as ASDO writes them, nothing for 0."""
    numbers = "".join(f"{count or ''}{separator}" for count in counts.T.ravel())
    return f"<SPECTRUM>{numbers if counts.any() else 'ZERO'}</SPECTRUM>"


def asdo(rows: list[Row]) -> list[str]:
    header = "Date,Time,Snow intensity (mm/h),Weather code SYNOP WaWa,Intensity of precipitation (mm/h),Spectrum"
    return [header] + [
        f"{_day(time, '{d}.{m}.{y}')},{time[11:]},9.000,0,{rate},{spectrum(counts, ',')}" for time, rate, counts in rows
    ]


def tagged(rows: list[Row]) -> list[str]:
    rest = "210.74;-9.999;20000;22067;0;2;0.03;23.4;0.000;0;0;NP;C;0"
    return ["Date;Time;Intensity of precipitation (mm/h);and so on;Spectrum"] + [
        f"{_day(time, '{y}/{m}/{d}')};{time[11:]};{rate};{rest};{spectrum(counts, ';')}" for time, rate, counts in rows
    ]


def telegrams(rows: list[Row]) -> list[str]:
    lines: list[str] = []
    for time, rate, counts in rows:
        fields = {"01": rate, "02": "0134.86", "09": "00060", "11": "00000", "20": time[11:], "22": ""}
        fields |= {"21": _day(time, "{d}.{m}.{y}"), "93": ";".join(velocity_major(counts)) + ";"}
        lines += [*(f"{number}:{fields[number]}" for number in sorted(fields)), ""]
    return lines


def campbell_columns(rows: list[Row]) -> list[str]:
    columns = ["TIMESTAMP", "RECORD", "snowIntensity", "rainIntensity", *(f"spectrum({i})" for i in range(1, 1025))]
    lines = [f'"{time}",{i},0,{rate},{",".join(velocity_major(counts))}' for i, (time, rate, counts) in enumerate(rows)]
    return ['"TOA5","CR1000"', ",".join(f'"{column}"' for column in columns), '"TS","RN"', '"","Smp"', *lines]


def campbell_field(rows: list[Row]) -> list[str]:
    header = '"TIMESTAMP","RECORD","Intensity","AccumulatedAmount","Code4680","Error","FieldN","Fieldv","RowData"'
    fields = '"-9.999,-9.999,","00.000,00.000,"'
    lines = [
        f'"{time}",{i},"{rate}","0000.00","00","000",{fields},"{",".join(velocity_major(counts))},"'
        for i, (time, rate, counts) in enumerate(rows)
    ]
    begin = ['"TOA5","7481","CR1000","7481","CR1000.Std.11","CPU:Parsivel.CR1","49567","Parsiv1"', header]
    return [*begin, '"TS","RN","","","","","","",""', '"","","Smp","Smp","Smp","Smp","Smp","Smp","Smp"', *lines]


def pyatmoslogger(rows: list[Row]) -> list[str]:
    numbers = [f"{i:02d}" for i in range(32)]
    names = ["datetime_utc", "rain rate [mm/h]", "rain accum [mm]", "Z [dBz]", "sample interval [s]"]
    names += ["Rain intensity 16 bit low [mm/h]", *(f"N{i}" for i in numbers), *(f"v{i}" for i in numbers)]
    names += [f"M_{i}_{j}" for i in range(32) for j in range(32)]
    rest = ["99", *["-9.999"] * 32, *["00.000"] * 32]
    return [";".join(names)] + [
        ";".join([time, rate, "0003.69", "-9.999", "00060", *rest, *velocity_major(counts)])
        for time, rate, counts in rows
    ]


def scamp(rows: list[Row]) -> list[str]:
    names = "time;rainfall_rate_32bit;rainfall_accumulated_32bit;sample_interval;sensor_time;station_name;"
    names += "raw_drop_concentration;raw_drop_average_velocity;raw_drop_number"
    spectra = ",".join(["-9.999"] * 32)
    return [names] + [
        f"{time};{rate};0019.25;00060;01:32:00;SCAMP;{spectra};{spectra};{','.join(velocity_major(counts))}"
        for time, rate, counts in rows
    ]


STATING_DIALECTS = (station, full, telegrams, pyatmoslogger, scamp)
"""Those that write each record's length, a minute."""

SILENT_DIALECTS = (locarno, asdo, tagged, campbell_columns, campbell_field)
"""Those whose records are as long as the step between them."""
