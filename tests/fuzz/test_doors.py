"""Hostile messages, some dozens a door: each is answered or refused, and a sound client is served as before."""

from random import Random

import pytest

from .doors import DOORS

_MESSAGES = 60


@pytest.mark.parametrize("name", DOORS)
def test_hostile_messages_cost_their_sender_only(name: str) -> None:
    door = DOORS[name]
    pytest.importorskip(door.package)
    with door.open() as address:
        attack = door.attack(address)
        attack.check_others()
        for number in range(_MESSAGES):
            attack.send(Random(number))
        attack.check_others()
        attack.close()
