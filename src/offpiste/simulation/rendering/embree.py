"""Ray casting by Embree's C interface, in packets of neighbouring rays as wide as the processor's registers.

Packets take a quarter of the time of embreex's single rays, and shared meshes a quarter of the time to build a scene.
"""

import ctypes
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from offpiste.core.errors import OffpisteError, extra
from offpiste.native.library import entry

with extra("sim"):
    import embreex

Points = Float[np.ndarray, "_ 3"]
Numbers = Float[np.ndarray, " n"]
Indices = Int[np.ndarray, " n"]

_CASTER = (int, int, int, int)
_first_hits = entry("first_hits", *_CASTER, int, int, "f4", "f4", "f4", "i4", "i4", "f4")
_any_hits = entry("any_hits", *_CASTER, int, int, "f4", "f4", "b1")
"""Entries of rays.h; `_CASTER`: addresses of function, scene and arguments, and number of rays in a packet."""

_ADDRESS = ctypes.c_void_p
_RAY16_NATIVE = 34
_TRIANGLES, _QUADRILATERALS, _INDEX, _VERTEX, _UINT3, _UINT4, _FLOAT3 = 0, 1, 0, 1, 0x5003, 0x5004, 0x9003
_ROBUST, _COHERENT, _ALL_FEATURES = 4, 1 << 16, 0xFFFFFFFF
"""Enumeration values of Embree 4, from RTCDeviceProperty to RTCRayQueryFlags (rtcore_device.h and others)."""


@dataclass(frozen=True)
class Mesh:
    """Triangles or quadrilaterals of one surface."""

    surface: str  # name in `scene.SURFACES`
    vertices: Float[np.ndarray, "v 3"]  # [m]
    # Indices of vertices; quadrilaterals are folded along the diagonal of corners 1 and 3
    faces: Int[np.ndarray, "f corners"]
    item: Int[np.ndarray, " f"]  # plant or box of each face


class _Arguments(ctypes.Structure):
    """RTCIntersectArguments and RTCOccludedArguments."""

    _fields_ = (
        ("flags", ctypes.c_uint),
        ("feature_mask", ctypes.c_uint),
        ("context", _ADDRESS),
        ("filter", _ADDRESS),
        ("function", _ADDRESS),
        ("min_width", ctypes.c_float),
    )


class RayCaster:
    """Meshes prepared for rays in single precision, with one origin each or a common origin."""

    def __init__(self, parts: Sequence[Mesh]) -> None:
        library = _library()
        device = _ADDRESS(library.rtcNewDevice(None))
        scene = _ADDRESS(library.rtcNewScene(device))
        weakref.finalize(self, _release, library, device, scene)
        library.rtcSetSceneFlags(scene, _ROBUST)
        self._shared = [_attach(library, device, scene, part) for part in parts]
        library.rtcCommitScene(scene)
        if error := library.rtcGetDeviceError(device):
            raise MemoryError(f"Embree cannot build a scene of {len(parts)} meshes (error {error})")
        lanes = 16 if library.rtcGetDeviceProperty(device, _RAY16_NATIVE) else 8
        self._arguments = _Arguments(_COHERENT, _ALL_FEATURES)
        functions = (getattr(library, f"rtc{name}{lanes}") for name in ("Intersect", "Occluded"))
        self._intersect, self._occluded = (
            (ctypes.cast(function, _ADDRESS).value, scene.value, ctypes.addressof(self._arguments), lanes)
            for function in functions
        )

    def intersect(
        self, origins: Points, directions: Points, distance: Numbers, part: Indices, face: Indices, normal: Points
    ) -> None:
        """Find the first hits; `part` is -1 without a hit.

        Updates distance, face and normal where a hit is nearer than `distance`, in lengths of the direction. Normals
        have any length and point to the side from which corners are counter-clockwise.

        Raises:
            ValueError: lengths differ.
        """
        sizes = _sizes(origins, directions, distance, part, face, normal)
        _first_hits(*self._intersect, *sizes, origins, directions, distance, part, face, normal)

    def occluded(self, origins: Points, directions: Points) -> Bool[np.ndarray, " n"]:
        """Return whether each ray hits anything."""
        blocked = np.empty(len(directions), np.bool_)
        _any_hits(*self._occluded, *_sizes(origins, directions), origins, directions, blocked)
        return blocked


def _sizes(origins: Points, directions: Points, *of_rays: np.ndarray) -> tuple[int, int]:
    """Return the number of origins and of rays."""
    count = len(directions)
    shapes = {array.shape[1:] for array in (origins, directions)}
    if shapes != {(3,)} or len(origins) not in (1, count) or any(len(array) != count for array in of_rays):
        raise ValueError(
            f"expected 1 or {count} origins and {count} results for {count} rays, not {len(origins)} origins"
        )
    return len(origins), count


@cache
def _library() -> ctypes.CDLL:
    """Return the Embree 4 library in the wheel of embreex."""
    files = sorted(Path(embreex.__file__).parents[1].glob("embreex*/**/*embree4*"))
    if not files:
        raise OffpisteError("embreex does not contain Embree's library", how="install the wheel of embreex from PyPI")
    library = ctypes.CDLL(str(files[0]))
    for name in ("rtcNewDevice", "rtcNewScene", "rtcNewGeometry"):
        getattr(library, name).restype = _ADDRESS
    library.rtcGetDeviceProperty.restype = ctypes.c_ssize_t
    return library


def _attach(library: ctypes.CDLL, device: Any, scene: Any, part: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Add a part to a scene; returns the arrays that Embree reads from then on."""
    corners = part.faces.shape[1]
    # Embree reads 16 bytes per vertex, also for the last one.
    vertices = np.append(part.vertices.astype(np.float32, copy=False).reshape(-1), np.float32(0))
    faces = np.ascontiguousarray(part.faces, np.int32)
    geometry = _ADDRESS(library.rtcNewGeometry(device, _TRIANGLES if corners == 3 else _QUADRILATERALS))
    for kind, form, values, row, rows in (
        (_VERTEX, _FLOAT3, vertices, 3, len(part.vertices)),
        (_INDEX, _UINT3 if corners == 3 else _UINT4, faces, corners, len(faces)),
    ):
        size = (ctypes.c_size_t(0), ctypes.c_size_t(4 * row), ctypes.c_size_t(rows))
        library.rtcSetSharedGeometryBuffer(geometry, kind, 0, form, _ADDRESS(values.ctypes.data), *size)
    library.rtcCommitGeometry(geometry)
    library.rtcAttachGeometry(scene, geometry)
    library.rtcReleaseGeometry(geometry)
    return vertices, faces


def _release(library: ctypes.CDLL, device: Any, scene: Any) -> None:
    library.rtcReleaseScene(scene)
    library.rtcReleaseDevice(device)
