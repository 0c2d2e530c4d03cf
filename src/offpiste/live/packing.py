"""What processes hand to each other, as bytes and back: texts, numbers and arrays by name, without code in them."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, Final

import msgspec
import numpy as np
import torch

from offpiste.live.sensor_messages import Sensors
from offpiste.logs.measurements import Camera, Cloud, Image, Lidar
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.planning.course import Course
from offpiste.rig.camera import CameraModel
from offpiste.rig.rig import Rig
from offpiste.runtime.estimator import VehicleReading
from offpiste.runtime.follower import TimedPlan
from offpiste.runtime.prediction import Prediction

_ARRAY: Final = "__array__"
Values = Mapping[str, Any]


def packed(values: Values) -> bytes:
    """Numbers, texts, lists, mappings and arrays as bytes."""
    return msgspec.msgpack.encode(values, enc_hook=_plain)


def unpacked(data: bytes) -> dict[str, Any]:
    """What `packed` made; arrays can be written to."""
    return dict(_with_arrays(msgspec.msgpack.decode(data)))


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        whole = np.ascontiguousarray(value)
        return {_ARRAY: whole.dtype.str, "shape": list(whole.shape), "data": whole.tobytes()}
    if isinstance(value, np.generic):
        return value.item()
    raise NotImplementedError(type(value))


def _with_arrays(value: Any) -> Any:
    if isinstance(value, dict):
        if _ARRAY in value:
            return np.frombuffer(bytearray(value["data"]), np.dtype(value[_ARRAY])).reshape(value["shape"])
        return {key: _with_arrays(one) for key, one in value.items()}
    return [_with_arrays(one) for one in value] if isinstance(value, list) else value


def _fields(value: Any) -> dict[str, Any]:
    return {field.name: getattr(value, field.name) for field in fields(value)}


def pack_measured(measured: VehicleReading | Image | Cloud, **more: Any) -> bytes:
    """A reading, an image or a scan, and more."""
    return packed(_fields(measured) | more)


def reading_from(values: Values) -> VehicleReading:
    """A reading."""
    return VehicleReading(**{field.name: values[field.name] for field in fields(VehicleReading)})


def image_from(values: Values) -> Image:
    """An image."""
    return Image(**{field.name: values[field.name] for field in fields(Image)})


def cloud_from(values: Values) -> Cloud:
    """A scan."""
    return Cloud(**{field.name: values[field.name] for field in fields(Cloud)})


def pack_course(course: Course) -> bytes:
    """Unpack a course."""
    return packed(_fields(course))


def course_from(values: Values) -> Course:
    """A course."""
    return Course(**values)


def pack_sensors(sensors: Sensors) -> bytes:
    """Calibrations and mountings."""
    cameras, lidars = sensors
    models = {name: _fields(one.model) | {"mounting": one.body_from_camera} for name, one in cameras.items()}
    return packed({"cameras": models, "lidars": {name: one.body_from_lidar for name, one in lidars.items()}})


def sensors_from(values: Values, rig: Rig) -> Sensors:
    """Calibrations and mountings, with what the rig says of these sensors."""
    cameras = {}
    for name, given in values["cameras"].items():
        model = {field.name: given[field.name] for field in fields(CameraModel)}
        model["distortion"] = tuple(model["distortion"])
        cameras[name] = Camera(name, CameraModel(**model), given["mounting"], rig.cameras[name])
    lidars = {name: Lidar(name, mounting, rig.lidars[name]) for name, mounting in values["lidars"].items()}
    return cameras, lidars


def pack_layers(layers: TerrainLayers | None, **more: Any) -> bytes:
    """Layers of a map, and more; None for a map that is empty."""
    return packed({"layers": None if layers is None else _fields(layers)} | more)


def layers_from(values: Values) -> TerrainLayers | None:
    """Layers of a map."""
    return None if values["layers"] is None else TerrainLayers(**values["layers"])


def pack_plan(plan: TimedPlan, prediction: Prediction, **more: Any) -> bytes:
    """A plan, and where it leads."""
    controls = plan.controls.numpy()
    about = {"start": plan.start, "made": plan.made, "controls": controls, "gear": plan.gear}
    return packed(about | {"states": prediction.state} | more)


def plan_from(values: Values) -> tuple[TimedPlan, Prediction]:
    """A plan, and where it leads."""
    plan = TimedPlan(values["start"], values["made"], torch.from_numpy(values["controls"]), values["gear"])
    return plan, Prediction(values["start"], values["states"])
