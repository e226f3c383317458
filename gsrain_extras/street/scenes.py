"""The built-in streets, as entry points `gsrain.scenes`."""

import hashlib
from functools import partial
from inspect import getsource
from pathlib import Path

import msgspec

from gsrain_engine.scene import geometry, lamps, noise, rigs, skies
from gsrain_engine.scene.built_in import BuiltInScene

from .build import build_street, street_boxes
from .layout import STREETS


def _street(name: str, overcast_twin: str | None = None) -> BuiltInScene:
    parameters = STREETS[name]
    return BuiltInScene(
        build=partial(build_street, parameters),
        fingerprint=partial(_fingerprint, name),
        boxes=partial(street_boxes, parameters),
        overcast_twin=overcast_twin,
        time_of_day=parameters.time_of_day,
    )


def _fingerprint(name: str) -> str:
    """Hash of a street's parameters and of the sources that it is built by."""
    digest = hashlib.sha256(msgspec.json.encode(STREETS[name]))
    own = sorted(each for each in Path(__file__).parent.iterdir() if each.suffix in (".py", ".npz"))
    for source in own:
        digest.update(source.read_bytes())
    for shared in (geometry, lamps, noise, rigs, skies):
        digest.update(getsource(shared).encode())
    return digest.hexdigest()


STREET = _street("street", overcast_twin="street:overcast")
OVERCAST = _street("street:overcast")
DUSK = _street("street:dusk")
NIGHT = _street("street:night")
LONG = _street("street:long")
