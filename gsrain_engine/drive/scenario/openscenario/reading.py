"""OpenSCENARIO XML files, as far as they can be driven without a map."""

from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import msgspec
import numpy as np

from gsrain_engine.untrusted.explained_errors import converted

from ...vehicle.vehicle import Vehicle
from ..scenario import Scenario
from .events import Actor, behaviour
from .names import OWN_FIELDS, PROPERTY
from .objects import box_of, controlled_behaviour, ego_vehicle, look_of, own_properties
from .places import Beginning, beginnings, placed, world_state
from .xml_file import number, properties, read_xml


def read_openscenario(path: Path) -> Scenario:
    """Read an OpenSCENARIO XML file, version 1.0 to 1.3.

    Taken are: vehicles with their boxes, first positions (WorldPosition; RelativeLanePosition and
    RelativeObjectPosition to the ego vehicle, lanes 3.5 m wide) and speeds; one event each, of a lane change, a change
    of speed or a trajectory with times, set off by time, gap or time to collision; precipitation in mm/h (from 1.1 on:
    before it was a share without a unit) and wind; the time at which the storyboard stops. The ego vehicle is the one
    called Ego, or hero, or else the first; what it is told to do is left to the driver under test. It starts where the
    scene's own drive starts: all others are placed around it.

    Raises ValueError, with the file and the element, for what else matters and can't be taken.
    """
    root = read_xml(path)
    objects = {each.get("name", ""): each for each in root.iterfind("Entities/ScenarioObject")}
    begun = beginnings(path, root)
    if not objects:
        raise ValueError(f"{path}: there are no ScenarioObjects in it")
    ego_name = next((name for name in objects if name.lower() in ("ego", "hero")), next(iter(objects)))
    missing = next((name for name in objects if name not in begun), None)
    if missing is not None:
        raise ValueError(f"{path}: {missing} is not teleported anywhere at the start")
    header = root.find("FileHeader")
    own = {} if header is None else properties(header)
    vehicle = ego_vehicle(path, objects[ego_name])
    users, kept = list[dict[str, Any]](), list[str]()
    for name, entity in objects.items():
        if name == ego_name:
            continue
        if own_properties(entity).get(f"{PROPERTY}kept") == "true":
            kept.append(name)
        else:
            users.append(_user(path, root, name, entity, begun, ego_name, vehicle))
    plain = {
        "name": path.stem,
        "description": "" if header is None else header.get("description", ""),
        "speed_m_s": begun[ego_name].speed_m_s,
        "keep": kept,
        "road_users": users,
        "rain": _rain(path, root, own),
        "vehicle": msgspec.to_builtins(vehicle),
        **_duration(path, root),
        **{name: own[PROPERTY + name] for name in OWN_FIELDS if PROPERTY + name in own},
    }
    try:
        return converted(plain, Scenario, strict=False)
    except msgspec.ValidationError as error:
        raise ValueError(f"{path}: {error}") from None


def _user(
    path: Path, root: Element, name: str, entity: Element, begun: dict[str, Beginning], ego_name: str, vehicle: Vehicle
) -> dict[str, Any]:
    box = box_of(path, entity)
    where = placed(path, name, begun[name], ego_name, begun[ego_name])
    # Both are placed by their points of reference, and ours by their middles.
    turned, ahead = np.radians(where["turned_deg"]), 0.0 if box is None else box[1]
    where["ahead_m"] += ahead * float(np.cos(turned)) - vehicle.middle_m
    where["left_m"] += ahead * float(np.sin(turned))
    where |= {each: round(where[each], 6) for each in ("ahead_m", "left_m")}
    speed, starts = begun[name].speed_m_s, [world_state(path, begun[each].position) for each in (name, ego_name)]
    actor = Actor(name, where["left_m"], speed, starts[0], ego_name, starts[1])
    return {
        "id": name,
        **look_of(path, name, entity),
        **({} if box is None else {"size_lwh_m": box[0]}),
        **where,
        "speed_m_s": speed,
        "behaviour": controlled_behaviour(entity) or behaviour(path, root, actor),
    }


def _rain(path: Path, root: Element, own: dict[str, str]) -> dict[str, Any]:
    first = root.find("Storyboard/Init/Actions/GlobalAction/EnvironmentAction")
    if any(each is not first or each.find("Environment") is None for each in root.iter("EnvironmentAction")):
        raise ValueError(f"{path}: weather that changes, or comes from a catalogue: only one Environment at the start")
    weather = None if first is None else first.find("Environment/Weather")
    plain: dict[str, Any] = {"seed": own.get(f"{PROPERTY}seed", "0")}
    rain, wind = (None, None) if weather is None else (weather.find("Precipitation"), weather.find("Wind"))
    if rain is not None and rain.get("precipitationType") != "dry":
        if rain.get("precipitationType") != "rain":
            raise ValueError(f"{path}: it {rain.get('precipitationType')}s: only rain falls here")
        if "precipitationIntensity" not in rain.attrib:
            raise ValueError(f"{path}: precipitation without precipitationIntensity: its share 0..1 says no mm/h")
        plain["intensity_mm_h"] = number(path, rain, "precipitationIntensity")
    if wind is not None:
        speed, direction = number(path, wind, "speed"), number(path, wind, "direction")
        plain["wind_m_s"] = [round(float(speed * each(direction)), 9) + 0.0 for each in (np.cos, np.sin)]
    return plain


def _duration(path: Path, root: Element) -> dict[str, float]:
    stop = root.find("Storyboard/StopTrigger")
    end = None if stop is None else stop.find(".//SimulationTimeCondition")
    return {} if end is None else {"duration_s": number(path, end, "value")}
