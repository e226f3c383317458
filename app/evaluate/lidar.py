"""`gsrain evaluate lidar`: lidar returns in rain, by intensity and range."""

from pathlib import Path
from typing import Annotated

from gsrain_engine.evaluation.lidar.settings import SENSOR_NAMES, LidarSettings, SensorSettings
from gsrain_engine.rain.settings import RainSettings

from ..console import print, print_lines, run_with_progress
from ..options import (
    AllowOutside,
    JsonFileOrScreen,
    let_names_lead_outside,
    named_options,
    option,
    options_of,
    takes_set,
)
from ..outputs import claim_outputs, table_stream, write_numbers

LimitOptions = options_of(
    SensorSettings,
    "evaluate lidar",
    defaults={"range_m": "the sensor's; of a capture, estimated", "least_reflectance": "the sensor's"},
    topic="Sensor",
)
AirOptions = options_of(
    RainSettings, "evaluate lidar", topic="Rain", fixed={"intensity_mm_h": "--rain", "seed": "--seeds"}
)
ConditionOptions = options_of(LidarSettings, "evaluate lidar", topic="Rain")


@takes_set
def lidar(
    source: Annotated[str, option("Scene, or capture with lidar; default: the street.", "SCENE|CAPTURE")] = "street",
    /,
    *,
    output: Annotated[Path, option("Folder for figure, table and sweeps.", "--output", "-o", topic="Output")],
    conditions: ConditionOptions | None = None,
    air: AirOptions | None = None,
    sensor: Annotated[
        str, option(f"{', '.join(SENSOR_NAMES)} (beams, or nm), or a YAML file of a sensor.", topic="Sensor")
    ] = "64",
    limits: LimitOptions | None = None,
    write_sweeps: Annotated[bool, option("Write each sweep in rain (.npz).", topic="Output")] = True,
    allow_outside: AllowOutside = False,
    json: JsonFileOrScreen = None,
) -> None:
    """Rain on a lidar: returns kept, lost and made up, by range, over intensities and seeds.

    Rain and fog attenuate light in both directions (the same beta as haze in images), nearby drops of the same field
    return echoes, as does the spray of fast vehicles in a scene, and a wet road mirrors. A capture's own sweeps count
    as those of clear weather. In a scene a virtual sensor is on the ego's roof.
    """
    from gsrain_engine.datasets.open_source import open_source, source_hash
    from gsrain_engine.evaluation.lidar.session import evaluate_lidar, open_sensor
    from gsrain_engine.rain.available import check_available
    from gsrain_engine.scene.open import file_hash

    let_names_lead_outside(allow_outside)
    chosen_air = air or AirOptions()
    settings, rain = (conditions or ConditionOptions()).settings(), chosen_air.settings()
    check_available(chosen_air.changes(), rain, "lidar")
    changes = (limits or LimitOptions()).changes()
    claim_outputs(output / "lidar.png", output / "report.html", json, folders=[output])
    with named_options(SensorSettings, "sensor"):
        chosen = open_sensor(sensor, changes)
    inputs = {source: source_hash(source)} | ({} if sensor in SENSOR_NAMES else {sensor: file_hash(Path(sensor))})
    work = evaluate_lidar(
        open_source(source), chosen, rain, settings, estimates_range="range_m" not in changes, inputs=inputs,
        sweeps=output / "sweeps" if write_sweeps else None,
    )  # fmt: skip
    report = run_with_progress(work)
    screen = table_stream(json)
    print(f"{chosen.name}; 10 % is detected up to {report.strongest.turn.sensor.range_m:.0f} m", file=screen)
    for table in report.tables:
        print(f"{table.title}:", file=screen)
        print_lines(f"{table.text}\n", file=screen)
    for sentence in report.notes:
        print(sentence, file=screen)
    written = report.save(output)
    print(f"wrote {output}: {', '.join(written)}" + (", sweeps/" if write_sweeps else ""), file=screen)
    write_numbers(json, report.plain)
