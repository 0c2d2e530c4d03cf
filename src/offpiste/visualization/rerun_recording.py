"""Rerun recordings (rerun.io) of a drive: images, features, scans, map and wheel tracks over time.

Data is streamed to the file, so that memory does not grow with the drive. Positions are relative to the vehicle's first
position, because viewers use float32.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from matplotlib import colormaps

from offpiste.core.errors import extra
from offpiste.mapping.replay import Moment
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.perception.projection import CameraView
from offpiste.report.feature_colours import colours
from offpiste.visualization.map_figure import STEEP, TALL

OFFSET: Final = np.array([-14.0, -14.0, 11.0])
"""Offset of the viewer's eye from the vehicle's first position [m]."""
EPOCH: Final = 1e8
"""Times above this are dates; smaller times count from the log's zero [s]."""
SCAN_POINTS, SCAN_INTERVAL = 10_000, 0.2
"""Largest number of points of a scan, and time between two scans [s]."""
MAP_METRES, MAP_STEP = 5.0, 2
"""Distance driven between two updates of the map [m], and step between its written cells, which divides `TILE`."""
QUALITY: Final = 80
"""JPEG quality of images."""
GREY: Final = np.array([120, 120, 120], np.uint8)
"""Colour of ground without features."""
TILE: Final = 100
"""Number of cells along the side of a tile: 20 m of a map of 0.2 m."""


def following_eye(vehicle: str, start: Float[np.ndarray, " 3"]) -> Any:
    """Return the controls of a viewer's eye that follows a vehicle.

    Args:
        vehicle: entity of the vehicle.
        start: its first position in the recording's frame [m].
    """
    import rerun.blueprint as rrb

    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=start + OFFSET, look_target=start, tracking_entity=vehicle
    )


@dataclass(frozen=True)
class Tile:
    """Square part of a map at a fixed position in the world.

    Attributes:
        place: x and y of the tile, in tiles.
        cells: rows and columns of the map, in steps, with one more at the upper ends so that tiles meet.
    """

    place: tuple[int, int]
    cells: tuple[slice, slice]


def tiles(layers: TerrainLayers, step: int) -> Iterator[Tile]:
    """Yield the tiles that a map covers, at least in part.

    Args:
        step: between the cells that are taken, the same cells wherever the map is; divides `TILE`.
    """
    left, bottom = np.floor(layers.origin / layers.resolution).astype(int).tolist()  # cell i covers [i, i + 1) cells
    ny, nx = layers.known.shape
    for y in range(bottom // TILE, (bottom + ny - 1) // TILE + 1):
        for x in range(left // TILE, (left + nx - 1) // TILE + 1):
            yield Tile((x, y), (_between(y, bottom, ny, step), _between(x, left, nx, step)))


def _between(tile: int, low: int, count: int, step: int) -> slice:
    first = max(tile * TILE, low)
    first += -first % step
    return slice(first - low, min((tile + 1) * TILE + 1, low + count) - low, step)


def grid_triangles(known: Bool[np.ndarray, "h w"]) -> Int[np.ndarray, "T 3"]:
    """Return two triangles, counter-clockwise from above, for each square of four known cells, by index."""
    number = np.where(known, np.cumsum(known).reshape(known.shape) - 1, -1)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    whole = (a >= 0) & (b >= 0) & (c >= 0) & (d >= 0)
    lower, upper = np.stack((a, b, d), axis=-1)[whole], np.stack((a, d, c), axis=-1)[whole]
    return np.concatenate((lower, upper))


class Recorder:
    """Writer of one recording.

    Args:
        origin: of the recording in the world frame [m].
        limits: colours of the features; None without features.

    Raises:
        MissingExtra: the extra `view` is not installed.
    """

    def __init__(
        self,
        path: Path,
        origin: Float[np.ndarray, " 3"],
        limits: Float[np.ndarray, "2 3"] | None,
        cameras: tuple[str, ...],
    ) -> None:
        with extra("view", otherwise="go without: --no-rrd"):
            import rerun as rr
        self._rr = rr
        self._origin, self._limits = origin, limits
        # Times, position and content of what was last written
        self._image_times: dict[str, float] = {}
        self._scan_time, self._map_at = -np.inf, np.full(3, np.inf)
        self._tiles: dict[tuple[int, int], tuple[int, float]] = {}
        self._stream = rr.RecordingStream("offpiste")
        self._stream.save(path, default_blueprint=_blueprint(cameras, limits is not None))
        self._stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def close(self) -> None:
        """Write buffered data and close the file."""
        self._stream.flush()
        self._stream.disconnect()

    def add_path(self, wheels: Float[np.ndarray, "N 4 3"]) -> None:
        """Add the tracks of the wheels, shown at all times [m]; NaN if unknown."""
        strips = [
            strip.astype(np.float32) for number in range(4) for strip in _unbroken(wheels[:, number] - self._origin)
        ]
        rr = self._rr
        self._stream.log("world/wheels", rr.LineStrips3D(strips, radii=0.05, colors=[230, 80, 30]), static=True)

    def add_vehicle(self, wheels: Float[np.ndarray, "4 2"]) -> None:
        """Add a frame through the wheels and an arrow ahead, around the pose point [m]."""
        rr, corners = self._rr, np.pad(wheels[[0, 1, 3, 2, 0]], ((0, 0), (0, 1)))
        self._stream.log(
            "world/vehicle/frame", rr.LineStrips3D([corners], radii=0.06, colors=[20, 90, 200]), static=True
        )
        ahead = rr.Arrows3D(vectors=[[wheels[:, 0].max() + 1.0, 0, 0]], radii=0.06, colors=[20, 90, 200])
        self._stream.log("world/vehicle/ahead", ahead, static=True)

    def add(self, moment: Moment, world_from_body: Float[np.ndarray, "4 4"]) -> None:
        """Add the new data of a moment."""
        for view, image, features in zip(moment.views, moment.images, moment.features, strict=True):
            if self._image_times.get(view.camera.name) != view.time:
                self._image_times[view.camera.name] = view.time
                self._add_image(view, image, features)
        self._at(moment.time)
        place = world_from_body[:3, 3] - self._origin
        self._stream.log("world/vehicle", self._rr.Transform3D(translation=place, mat3x3=world_from_body[:3, :3]))
        if moment.time - self._scan_time >= SCAN_INTERVAL:
            self._scan_time = moment.time
            self._add_scan(moment)
        if not np.linalg.norm(moment.vehicle - self._map_at) < MAP_METRES:
            self.add_map(moment)

    def add_map(self, moment: Moment) -> None:
        """Add the tiles of the map with news since they were last written."""
        self._at(moment.time)
        self._map_at = moment.vehicle.copy()
        for tile in tiles(moment.layers, MAP_STEP):
            if self._has_news(moment.layers, tile):
                self._add_tile(moment.layers, tile)

    def _at(self, time: float) -> None:
        if time > EPOCH:
            self._stream.set_time("log", timestamp=time)
        else:
            self._stream.set_time("log", duration=time)

    def _add_image(
        self, view: CameraView, image: UInt8[np.ndarray, "h w 3"], features: Float[np.ndarray, "rows columns F"]
    ) -> None:
        rr, camera, pose = self._rr, view.camera, view.world_from_camera
        self._at(view.time)
        place = f"world/cameras/{camera.name}"
        width, height = camera.model.size
        self._stream.log(
            place,
            rr.Transform3D(translation=pose[:3, 3] - self._origin, mat3x3=pose[:3, :3]),
            rr.Pinhole(
                image_from_camera=camera.model.matrix,
                resolution=[width, height],
                camera_xyz=rr.ViewCoordinates.RDF,
                image_plane_distance=1.5,
            ),
        )
        jpeg = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1]
        self._stream.log(f"{place}/image", rr.EncodedImage(contents=jpeg.tobytes(), media_type="image/jpeg"))
        if self._limits is not None:
            self._stream.log(f"features/{camera.name}", rr.Image(colours(features, self._limits)))

    def _add_scan(self, moment: Moment) -> None:
        every = max(1, -(-len(moment.points_world) // SCAN_POINTS))
        points = (moment.points_world[::every] - self._origin).astype(np.float32)
        shade = np.broadcast_to(GREY, (len(points), 3)).copy()
        if self._limits is not None and moment.projection is not None:
            seen = moment.projection.seen[::every]
            shade[seen] = colours(moment.projection.gather(moment.features)[::every][seen], self._limits)
        self._stream.log("world/scan", self._rr.Points3D(points, colors=shade, radii=0.04))

    def _has_news(self, layers: TerrainLayers, tile: Tile) -> bool:
        """Return whether the tile has gained enough known or closely observed cells since it was last written."""
        count = int(layers.known[tile.cells].sum())
        near = layers.distance[tile.cells][layers.valid[tile.cells]]
        seen = float((1 / np.maximum(near, 2.0)).sum())
        before = self._tiles.get(tile.place, (0, 0.0))
        # A tile that leaves the map shrinks; its last state stays in the file.
        news = count >= before[0] and (count > 1.03 * before[0] or seen > 1.15 * before[1])
        if news:
            self._tiles[tile.place] = count, seen
        return news

    def _add_tile(self, layers: TerrainLayers, tile: Tile) -> None:
        rr, cells, name = self._rr, tile.cells, "{}_{}".format(*tile.place)
        known, slope, height = (layer[cells] for layer in (layers.known, layers.slope, layers.obstacle_height))
        place = np.dstack((layers.centres[cells], layers.elevation[cells]))
        place = (place - self._origin).astype(np.float32)
        triangles = grid_triangles(known)
        if len(triangles):
            shade = np.broadcast_to(GREY, place.shape).copy()
            if self._limits is not None:
                valid = layers.valid[cells]
                shade[valid] = colours(layers.features[cells][valid], self._limits)
            mesh = rr.Mesh3D(
                vertex_positions=place[known],
                triangle_indices=triangles,
                vertex_normals=np.nan_to_num(layers.normal[cells][known], nan=0.0),
                vertex_colors=shade[known],
            )
            self._stream.log(f"world/map/ground/{name}", mesh)
        sloped, standing = known & np.isfinite(slope), known & (height > 0.2)
        self._add_points(f"world/map/slope/{name}", place[sloped], slope[sloped] / STEEP, "viridis")
        place[..., 2] += np.nan_to_num(height)
        self._add_points(f"world/map/obstacles/{name}", place[standing], height[standing] / TALL, "YlOrRd")

    def _add_points(
        self, name: str, points: Float[np.ndarray, "n 3"], share: Float[np.ndarray, " n"], colour_map: str
    ) -> None:
        shade = (255 * colormaps[colour_map](share.clip(0, 1))[:, :3]).astype(np.uint8)
        self._stream.log(name, self._rr.Points3D(points, colors=shade, radii=0.1))


def _blueprint(cameras: tuple[str, ...], features: bool) -> Any:
    """Return the layout of a viewer: the world, and beside it images and their features; slopes are hidden."""
    import rerun.blueprint as rrb

    world = rrb.Spatial3DView(
        origin="/world",
        name="world",
        contents=["+ /world/**", "- /world/map/slope/**"],
        eye_controls=following_eye("/world/vehicle", np.zeros(3)),
        line_grid=False,
    )
    images = [rrb.Spatial2DView(origin=f"/world/cameras/{name}", name=name) for name in cameras]
    if features:
        images += [rrb.Spatial2DView(origin=f"/features/{name}", name=f"features of {name}") for name in cameras]
    whole = rrb.Horizontal(world, rrb.Vertical(*images), column_shares=[3, 1]) if images else world
    return rrb.Blueprint(whole, rrb.TimePanel(timeline="log", state="collapsed"), collapse_panels=True)


def _unbroken(path: Float[np.ndarray, "N 3"]) -> list[Float[np.ndarray, "_ 3"]]:
    """Return the pieces of a path between unknown positions."""
    known = np.isfinite(path).all(axis=1)
    edges = np.flatnonzero(np.diff(known.astype(int), prepend=0, append=0))
    return [path[a:b] for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a > 1]
