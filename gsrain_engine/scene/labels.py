"""Semantic classes of surfaces."""

from enum import IntEnum


class Label(IntEnum):
    """Semantic class of a surface; 0 is reserved for pixels that show nothing."""

    NOTHING = 0
    ROAD = 1
    LANE_MARKING = 2
    PAVEMENT = 3
    BUILDING = 4
    VEGETATION = 5
    CAR = 6
    POLE = 7
    SIGN = 8
    FURNITURE = 9
    TERRAIN = 10
    SKY = 11
    TRUCK = 12
    BUS = 13
    PERSON = 14
    BICYCLE = 15
    TRAFFIC_LIGHT = 16
