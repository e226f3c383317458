"""How far one gets in a time while the speed changes at a rate, until it is what it should be."""


def changed_speed(speed_m_s: float, to_m_s: float, rate_m_s2: float, dt_s: float) -> tuple[float, float]:
    """Return the speed after a time, and the distance driven, where it goes to another at a rate and then stays."""
    needed_s = abs(to_m_s - speed_m_s) / rate_m_s2 if rate_m_s2 > 0 else float("inf")
    changing_s = min(needed_s, dt_s)
    sign = 1.0 if to_m_s >= speed_m_s else -1.0
    after = to_m_s if needed_s <= dt_s else speed_m_s + sign * rate_m_s2 * dt_s
    return after, 0.5 * (speed_m_s + after) * changing_s + after * (dt_s - changing_s)
