"""Gear box: forward, neutral and reverse, shifted at a standstill, neutral while it shifts."""


class GearBox:
    """Forward at first.

    Args:
        steps: `conventions.DT` that a shift takes.
    """

    def __init__(self, steps: int) -> None:
        self._steps, self._lever, self._left = steps, 1.0, 0

    @property
    def engaged(self) -> float:
        """1 forward, -1 reverse, 0 neutral."""
        return 0.0 if self._left else self._lever

    def shift(self, wanted: float | None, *, moving: bool) -> None:
        """One step on, with the lever where it is wanted, unless the vehicle moves.

        Args:
            wanted: 1, 0 or -1; None leaves the lever.
        """
        self._left = max(self._left - 1, 0)
        if wanted is not None and wanted != self._lever and not moving:
            self._lever, self._left = float(wanted), self._steps
