"""From where a Rerun viewer first looks at a vehicle."""

from typing import Any, Final

import numpy as np
from jaxtyping import Float

OFFSET: Final = np.array([-14.0, -14.0, 11.0])
"""Of the eye from the vehicle's first place [m]."""


def following_eye(vehicle: str, start: Float[np.ndarray, " 3"]) -> Any:
    """An eye above and beside a vehicle, that goes along with it.

    Args:
        vehicle: its entity.
        start: its first place [m], in the recording's frame.
    """
    import rerun.blueprint as rrb

    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=start + OFFSET, look_target=start, tracking_entity=vehicle
    )
