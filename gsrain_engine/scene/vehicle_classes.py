"""Which classes of things are vehicles with paint and glass, as data sets and scenes call them."""

_VEHICLES = ("car", "truck", "van", "bus", "vehicle", "trailer", "tram", "train")
_CYCLES = ("cycl", "bike", "motor")


def is_vehicle(class_name: str) -> bool:
    """Whether a class is one of motor vehicles with a body: cars, trucks and trams, but neither bicycles nor riders."""
    name = class_name.lower()
    return any(word in name for word in _VEHICLES) and not any(word in name for word in _CYCLES)
