"""A log format from outside: EuRoC's folders of CSV tables, PNG images and calibrations (Burri et al., IJRR 2016).

    OFFPISTE_EXTENSIONS=euroc PYTHONPATH=examples/extending offpiste inspect MH_01_easy --rig my.toml

A file like this one in `src/offpiste/logs/formats/` is found by itself. A rig reads its tables as channels,
`topic = "state_groundtruth_estimate0"` and `fields = ["p_RS_R_x", ...]`, and its cameras as `topic = "cam0"`,
`info = "cam0"`; the body frame is "body".
"""

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float
from ruamel.yaml import YAML

from offpiste.core.errors import LogError
from offpiste.logs.log import LOG_FORMATS, Log, RawImage, Samples, Times, Topic
from offpiste.logs.transforms import Transform
from offpiste.rig.camera import CameraModel

MODELS = {"radial-tangential": "plumb_bob", "equidistant": "equidistant"}
"""EuRoC's names of distortion models and ROS's."""


@LOG_FORMATS.register("euroc")
class EurocLog(Log):
    """A drive: one topic a folder of `mav0`; fields are the columns of its data.csv, those of cameras have none."""

    description = "a EuRoC folder"
    has_sensors = True

    def __init__(self, path: Path) -> None:
        self.path, self._rows = path, {}
        self._topics: dict[str, Topic] = {}
        for table in sorted((path / "mav0").glob("*/data.csv")):
            name, is_camera = table.parent.name, (table.parent / "data").is_dir()
            header, *rows = csv.reader(table.read_text("utf-8").splitlines())
            fields = tuple(column.split("[")[0].strip() for column in header[1:])
            self._rows[name] = [row for row in rows if row]
            self._topics[name] = Topic(name, "images" if is_camera else "table", len(rows), () if is_camera else fields)

    @staticmethod
    def recognises(path: Path) -> bool:
        """Whether a folder has EuRoC's layout."""
        return any(path.glob("mav0/*/data.csv"))

    @property
    def topics(self) -> dict[str, Topic]:
        """One topic a folder."""
        return self._topics

    def _read(self, topic: Topic, fields: Sequence[str], stamps: str) -> Samples:
        try:
            values = np.array([row[1:] for row in self._rows[topic.name]], np.float64)
        except ValueError as error:
            where = self.path / "mav0" / topic.name / "data.csv"
            raise LogError(f"not rows of numbers: {error}", where=where, how="download the drive again") from error
        return Samples(self.stamps(topic.name), values[:, [topic.fields.index(field) for field in fields]])

    def stamps(self, topic: str, *, stamps: str = "header") -> Float[np.ndarray, " n"]:
        """Stamps of all rows [s]; the tables have nanoseconds."""
        return np.array([int(row[0]) for row in self._rows[topic]], np.int64) / 1e9

    def frame(self, topic: str) -> str:
        """Frame of a camera: the name of its folder."""
        return topic

    def transforms(self, topics: Sequence[str]) -> list[Transform]:
        """`body_from_camera` of each camera: T_BS of its sensor.yaml."""
        cameras = [name for name, topic in self.topics.items() if topic.type == "images"]
        matrices = [np.array(self._calibration(name)["T_BS"]["data"], np.float64).reshape(4, 4) for name in cameras]
        return [Transform("body", name, matrix) for name, matrix in zip(cameras, matrices, strict=True)]

    def camera_model(self, topic: str, *, rectified: bool) -> tuple[CameraModel, Float[np.ndarray, "4 4"]]:
        """Calibration of a camera by its sensor.yaml."""
        found = self._calibration(topic)
        width, height = found["resolution"]
        fx, fy, cx, cy = found["intrinsics"]
        matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        distortion, model = tuple(found["distortion_coefficients"]), found["distortion_model"]
        return CameraModel(width, height, matrix, () if rectified else distortion, MODELS.get(model, model)), np.eye(4)

    def images(self, topic: str, *, stamps: str = "header", times: Times | None = None) -> Iterator[RawImage]:
        """Images of the PNG files that the table names."""
        for time, row in zip(self.stamps(topic), self._rows[topic], strict=True):
            if times is not None and time not in times:
                continue
            decoded = cv2.imread(str(self.path / "mav0" / topic / "data" / row[1].strip()), cv2.IMREAD_COLOR)
            yield RawImage(float(time), topic, None if decoded is None else cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB))

    def _calibration(self, topic: str) -> Any:
        path = self.path / "mav0" / topic / "sensor.yaml"
        if not path.is_file():
            raise LogError("no calibration", where=path, how="download the drive again")
        # OpenCV's first line, "%YAML:1.0", is not YAML.
        lines = [line for line in path.read_text("utf-8").splitlines() if not line.startswith("%")]
        return YAML(typ="safe").load("\n".join(lines))
