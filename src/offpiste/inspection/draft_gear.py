"""Gears of a first rig: what recorded letters, switches and positions of a selector stand for."""

import re
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.inspection.channel_guesses import Guess

_REVERSE: Final = re.compile(r"reverse", re.IGNORECASE)
_SELECTOR: Final = re.compile(r"prnd", re.IGNORECASE)
_LETTERS: Final = {"P": 0, "R": -1, "N": 0, "D": 1}
"""Positions of a selector, in its order, and the gear of each."""


def gear_values(guess: Guess, values: Float[np.ndarray, " n"]) -> tuple[str, ...]:
    """What recorded gears stand for, where they are letters, a switch for reverse, or a selector's positions."""
    there = {float(value) for value in np.unique(values)}
    named = (guess.topic, *guess.fields)
    if there <= {float(ord(letter)) for letter in _LETTERS}:
        meanings = _LETTERS
    elif there <= {0.0, 1.0} and any(map(_REVERSE.search, named)):
        meanings = {"0": 1, "1": -1}
    elif there <= {0.0, 1.0, 2.0, 3.0} and any(map(_SELECTOR.search, named)):
        meanings = {str(position): gear for position, gear in enumerate(_LETTERS.values())}
    else:
        return ()
    return ("values = { " + ", ".join(f"{key} = {gear}" for key, gear in meanings.items()) + " }",)
