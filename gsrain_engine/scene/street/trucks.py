"""Delivery lorries in the object frame (x forward, y left, z up, origin at the bottom centre): a cab before a box."""

from dataclasses import replace

import numpy as np

from .labels import Label
from .layout import StreetLayout
from .parking import ParkedTruck
from .quads import Quads
from .truck_body import build_body
from .truck_cab import build_cab
from .truck_chassis import build_chassis
from .truck_form import TRUCK_FORM

_SMOOTH = 1.08
"""Gaussians of a truck are this much wider than elsewhere: paint shows every gap."""


def build_parked_trucks(layout: StreetLayout) -> Quads:
    """Build all parked trucks, in the world."""
    return Quads.joined(build_truck(each).placed((each.x, each.y, 0.0), each.turn_deg) for each in layout.trucks)


def build_truck(truck: ParkedTruck) -> Quads:
    form = TRUCK_FORM
    parts = [build_cab(form, truck.cab), build_body(form, truck.body, truck.sign), build_chassis(form)]
    built = Quads.joined(parts)
    return replace(built, labels=np.full_like(built.labels, Label.TRUCK), spread=_SMOOTH * built.spread)
