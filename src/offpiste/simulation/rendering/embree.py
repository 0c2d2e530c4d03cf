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
from offpiste.native.compilation import RAYS, call_address

with extra("sim"):
    import embreex

Points = Float[np.ndarray, "_ 3"]
Numbers = Float[np.ndarray, " n"]
Indices = Int[np.ndarray, " n"]

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
        self._lanes = 16 if library.rtcGetDeviceProperty(device, _RAY16_NATIVE) else 8
        self._arguments = _Arguments(_COHERENT, _ALL_FEATURES)
        functions = (getattr(library, f"rtc{name}{self._lanes}") for name in ("Intersect", "Occluded"))
        self._intersect, self._occluded = (
            (ctypes.cast(function, _ADDRESS).value, scene.value, ctypes.addressof(self._arguments))
            for function in functions
        )

    def intersect(
        self, origins: Points, directions: Points, distance: Numbers, part: Indices, face: Indices, normal: Points
    ) -> None:
        """Find the first hits; `part` is -1 without a hit.

        Updates distance, face and normal where a hit is nearer than `distance`, in lengths of the direction. Normals
        have any length and point to the side from which corners are counter-clockwise.
        """
        _first_hits(*self._intersect, *_packet(self._lanes), origins, directions, distance, part, face, normal)

    def occluded(self, origins: Points, directions: Points) -> Bool[np.ndarray, " n"]:
        """Return whether each ray hits anything."""
        blocked = np.empty(len(directions), np.bool_)
        _any_hits(*self._occluded, *_packet(self._lanes), origins, directions, blocked)
        return blocked


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


_DIRECTION, _FAR, _MASK, _NORMAL, _FACE, _PART, _ROWS = 4, 8, 9, 12, 17, 18, 21
"""Rows of a packet (RTCRayHit16 or RTCRayHit8), four bytes per lane."""


def _packet(lanes: int) -> tuple[Float[np.ndarray, "rows lanes"], Int[np.ndarray, "rows lanes"]]:
    """Return views of an aligned packet as floats and as integers, followed by the mask of used lanes."""
    size = 4 * (_ROWS + 1) * lanes
    memory = np.zeros(size + 64, np.uint8)
    start = -memory.ctypes.data % 64
    integers = memory[start : start + size].view(np.int32).reshape(_ROWS + 1, lanes)
    return integers.view(np.float32), integers


@RAYS.inlined
def _start(numbers, integers, origins):  # type: ignore[no-untyped-def]
    # Set what all packets share: used lanes and a common origin. Returns the addresses of packet and mask.
    lanes = numbers.shape[1]
    for lane in range(lanes):
        integers[_ROWS, lane] = integers[_MASK, lane] = -1
        for axis in range(3):
            numbers[axis, lane] = origins[0, axis]
    packet = numbers.ctypes.data
    return packet, packet + 4 * lanes * _ROWS


@RAYS.inlined
def _fill(numbers, integers, first, origins, directions):  # type: ignore[no-untyped-def]
    # Write the rays of a packet without their distances; returns their number.
    lanes = numbers.shape[1]
    count = min(lanes, len(directions) - first)
    last = first + count - 1
    if len(origins) > 1:
        for lane in range(lanes):
            ray = min(first + lane, last)
            for axis in range(3):
                numbers[axis, lane] = origins[ray, axis]
    for lane in range(lanes):
        ray = min(first + lane, last)
        for axis in range(3):
            numbers[_DIRECTION + axis, lane] = directions[ray, axis]
    for lane in range(lanes):
        integers[_PART, lane] = -1
    for lane in range(count, lanes):
        integers[_ROWS, lane] = 0
    return count


@RAYS.entry
def _first_hits(  # type: ignore[no-untyped-def]
    function, scene, arguments, numbers, integers, origins, directions, distance, part, face, normal
):
    lanes = numbers.shape[1]
    packet, valid = _start(numbers, integers, origins)
    for first in range(0, len(directions), lanes):
        count = _fill(numbers, integers, first, origins, directions)
        for lane in range(count):
            numbers[_FAR, lane] = distance[first + lane]
        call_address(function, (valid, scene, packet, arguments))  # type: ignore[call-arg]
        for lane in range(count):
            ray = first + lane
            part[ray] = integers[_PART, lane]
            if part[ray] >= 0:
                distance[ray], face[ray] = numbers[_FAR, lane], integers[_FACE, lane]
                for axis in range(3):
                    normal[ray, axis] = numbers[_NORMAL + axis, lane]


@RAYS.entry
def _any_hits(function, scene, arguments, numbers, integers, origins, directions, blocked):  # type: ignore[no-untyped-def]
    lanes = numbers.shape[1]
    packet, valid = _start(numbers, integers, origins)
    for first in range(0, len(directions), lanes):
        count = _fill(numbers, integers, first, origins, directions)
        for lane in range(lanes):
            numbers[_FAR, lane] = np.inf
        call_address(function, (valid, scene, packet, arguments))  # type: ignore[call-arg]
        for lane in range(count):
            blocked[first + lane] = numbers[_FAR, lane] < 0  # set by Embree on a hit
