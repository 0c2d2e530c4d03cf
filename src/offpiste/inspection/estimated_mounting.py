"""Estimated mounting of a sensor and its presentation: angles, uncertainties and rig line, or the reason of failure."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from jaxtyping import Float
from rich.console import RenderableType
from rich.text import Text
from scipy.spatial.transform import Rotation

from offpiste.inspection.findings import Finding
from offpiste.rig.edits import Edit
from offpiste.rig.sensors import OPTICAL

AXES: Final = ("roll", "pitch", "yaw")


@dataclass(frozen=True)
class EstimatedMounting:
    """A sensor's mounting before and after estimation, or the reason of failure.

    Attributes:
        name: of the sensor in the rig.
        key: of the rig's entry, e.g. "lidars.top.body_from_lidar".
        optical: True for a camera, with axes z forward, x right, y down.
        guess, mounting: `body_from_sensor`; identical if the estimate failed.
        sigma: standard deviations of the rotation about the body's x, y and z [rad]; NaN without an estimate.
        place_sigma: standard deviations of the position [m]; NaN for coordinates taken from the guess.
        before, after: residual of the guess and of the estimate, in `unit`; NaN without comparable data.
        unit: "m" for LiDARs (median distance from another scan's planes), "px" for cameras (from epipolar lines).
        refused: reason of failure; "" if there is an estimate.
    """

    name: str
    key: str
    optical: bool
    guess: Float[np.ndarray, "4 4"]
    mounting: Float[np.ndarray, "4 4"]
    sigma: Float[np.ndarray, " 3"]
    place_sigma: Float[np.ndarray, " 3"]
    before: float
    after: float
    unit: str
    refused: str = ""

    @property
    def roll_pitch_yaw(self) -> Float[np.ndarray, " 3"]:
        """Return the mounting's angles [rad]; for cameras, with axes x forward, y left, z up."""
        return _euler(self.mounting, self.optical)

    @property
    def edit(self) -> Edit | None:
        """Return the rig line; None without an estimate."""
        if self.refused:
            return None
        orientation = Rotation.from_matrix(self.mounting[:3, :3]).as_quat()
        place = [round(v, 3) + 0.0 for v in self.mounting[:3, 3].tolist()]
        return Edit(self.key, {"position": place, "orientation": [round(v, 6) + 0.0 for v in orientation.tolist()]})

    def finding(self) -> Finding:
        """Return the result as a finding of `inspect`, with the rig line as its remedy."""
        if self.edit is None:
            how = "nothing; drive turns and over rough ground, or give it by hand"
            return Finding("warning", self.name, "its mounting could not be estimated", self.refused, how, 1.0)
        turn = float(Rotation.from_matrix(self.guess[:3, :3].T @ self.mounting[:3, :3]).magnitude())
        angles = ", ".join(
            f"{axis} {np.rad2deg(value):.2f} ± {np.rad2deg(sigma):.2f}"
            for axis, value, sigma in zip(AXES, self.roll_pitch_yaw, self.sigma, strict=True)
        )
        place = ", ".join(
            f"{axis} {value:.2f}" + (f" ± {sigma:.2f}" if np.isfinite(sigma) else " (the guess's)")
            for axis, value, sigma in zip("xyz", self.mounting[:3, 3], self.place_sigma, strict=True)
        )
        what = (
            "points lie off the planes of another scan" if self.unit == "m" else "features lie off their epipolar lines"
        )
        evidence = (
            f"{angles} degrees; {place} m; {what} by {self.after:.3g} {self.unit} (median), {self.before:.3g} before"
        )
        said = f"its mounting is estimated, {np.rad2deg(turn):.1f} degrees from the guess"
        return Finding("note", self.name, said, evidence, str(self.edit), 0.0, ((self.edit,),))

    def as_dict(self) -> dict[str, Any]:
        """Return plain numbers and strings for JSON, in degrees; unknown numbers are null."""
        return {
            "sensor": self.name,
            "refused": self.refused,
            "roll_pitch_yaw_deg": None if self.refused else np.rad2deg(self.roll_pitch_yaw).tolist(),
            "sigma_deg": _plain(np.rad2deg(self.sigma)),
            "position": None if self.refused else self.mounting[:3, 3].tolist(),
            "position_sigma": _plain(self.place_sigma),
            "residual_before": _plain(np.array([self.before]))[0],
            "residual_after": _plain(np.array([self.after]))[0],
            "residual_unit": self.unit,
            "key": self.key,
            "value": None if self.edit is None else self.edit.value,
            "line": "" if self.edit is None else str(self.edit),
        }


def render_mountings(results: Sequence[EstimatedMounting]) -> RenderableType:
    """Return the results of all sensors with their rig lines, for `rich.print`."""
    text = Text()
    for index, one in enumerate(results, start=1):
        finding = one.finding()
        text.append(f"{index}. {finding.where}: {finding.what}\n", style="yellow" if one.refused else "bold")
        text.append(f"   seen: {finding.evidence}\n   fix: ")
        text.append(f"{finding.remedy}\n", style="cyan")
    return text


def _euler(mounting: Float[np.ndarray, "4 4"], optical: bool) -> Float[np.ndarray, " 3"]:
    matrix = mounting[:3, :3] @ OPTICAL.T if optical else mounting[:3, :3]
    return np.asarray(Rotation.from_matrix(matrix).as_euler("ZYX")[::-1])


def _plain(values: Float[np.ndarray, " n"]) -> list[float | None]:
    return [float(v) if np.isfinite(v) else None for v in values]
