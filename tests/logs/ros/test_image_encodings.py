"""Every encoding of sensor_msgs/image_encodings, raw and compressed, against the encoded image."""

import cv2
import numpy as np
import pytest

from offpiste.core.errors import LogError
from offpiste.logs.measurements import Camera, in_eight_bits
from offpiste.logs.ros.image_encodings import PICTURES, pixels_of
from offpiste.logs.ros.writer import header, make
from offpiste.rig.camera import CameraModel
from offpiste.rig.sensors import CameraSource

Y, X = np.mgrid[:16, :24]
SCENE = np.stack((40 + 6 * X, 200 - 5 * X, 90 + 8 * Y), axis=-1).astype(np.uint8)
"""Colours that change evenly, so that interpolation between pixels is exact."""
GREY = np.repeat((40 + 6 * X + 2 * Y).astype(np.uint8)[..., None], 3, axis=2)
YUV = ("uyvy", "yuv422", "yuyv", "yuv422_yuy2", "nv12", "nv21")
CODECS = ("jpeg", "jpg", "png", "tiff", "webp", "bmp")
ORDERS = {"8UC1": "r", "8UC3": "bgr", "16UC3": "bgr", "8UC4": "bgra", "16UC4": "bgra", "mono8": "r", "mono16": "r"}
"""Orders of colours in encodings that do not name them."""


def camera(bits: int) -> Camera:
    return Camera("front", CameraModel(24, 16, np.eye(3)), np.eye(4), CameraSource(topic="/image", bits=bits))


def picture(name: str) -> np.ndarray:
    return GREY if ORDERS.get(name) == "r" else SCENE


def in_bits(pixels: np.ndarray, bits: int) -> np.ndarray:
    """Return the brightness in another bit depth."""
    return np.round(pixels * ((2**bits - 1) / 255)).astype(np.uint16 if bits > 8 else np.uint8)


def encoded(name: str, rgb: np.ndarray) -> np.ndarray:
    """Encode an image [rows, columns, channels] by the definition of the encoding, without OpenCV."""
    if name in YUV:
        return as_yuv(name, rgb)
    if name.startswith("bayer"):
        at = ["rgb".index(letter) for letter in name[6:10]]
        return np.choose(np.array(at).reshape(2, 2)[Y % 2, X % 2], np.moveaxis(rgb, -1, 0))[..., None]
    opaque = np.full((16, 24, 1), np.iinfo(rgb.dtype).max, rgb.dtype)
    order = ORDERS.get(name, name.rstrip("0123456789"))
    return np.concatenate((rgb, opaque), axis=-1)[..., ["rgba".index(letter) for letter in order]]


def as_yuv(name: str, rgb: np.ndarray) -> np.ndarray:
    """By BT.601, in 16 to 235; columns, or columns and rows, share the colour of the first."""
    matrix = np.array([[65.738, 129.057, 25.064], [-37.945, -74.494, 112.439], [112.439, -94.154, -18.285]]) / 256
    y, u, v = np.moveaxis(np.round(rgb @ matrix.T + [16, 128, 128]).astype(np.uint8), -1, 0)
    if name in ("nv12", "nv21"):
        pair = (u[::2, ::2], v[::2, ::2]) if name == "nv12" else (v[::2, ::2], u[::2, ::2])
        return np.concatenate((y, np.stack(pair, axis=-1).reshape(8, 24)))[..., None]
    colour = np.where(X % 2 == 0, u, np.roll(v, 1, axis=1))
    return np.stack((colour, y) if name in ("uyvy", "yuv422") else (y, colour), axis=-1)


def raw(name: str, numbers: np.ndarray, *, padding: int = 2, big: bool = False) -> object:
    rows = numbers.astype(numbers.dtype.newbyteorder(">" if big else "<")).reshape(len(numbers), -1).view(np.uint8)
    rows = np.pad(rows, ((0, 0), (0, padding)))
    sizes = {"height": 16, "width": 24, "step": rows.shape[1], "is_bigendian": int(big)}
    return make("sensor_msgs/Image", header=header(0, ""), encoding=name, data=rows.ravel(), **sizes)


def compressed(form: str, numbers: np.ndarray, suffix: str = ".png") -> object:
    data = cv2.imencode(suffix, numbers, [cv2.IMWRITE_JPEG_QUALITY, 100] if suffix == ".jpg" else [])[1].ravel()
    return make("sensor_msgs/CompressedImage", header=header(0, ""), format=form, data=data)


def read(message: object, bits: int = 0) -> np.ndarray:
    pixels = pixels_of(message, "/image")
    assert pixels is not None
    return in_eight_bits(pixels, camera(bits)).astype(int)


def assert_same(found: np.ndarray, name: str, within: int) -> None:
    inside = (slice(2, -2), slice(2, -2))  # edges have no neighbours to interpolate from
    np.testing.assert_allclose(found[inside], picture(name)[inside].astype(int), atol=within)


def tolerance(name: str) -> int:
    return 10 if name in YUV else 2 if name.startswith("bayer") else 0


@pytest.mark.parametrize("name", PICTURES)
def test_raw_images_are_the_picture_that_they_were_made_from(name: str) -> None:
    for bits in (10, 12, 14, 16) if PICTURES[name].depth == 16 else (8,):
        numbers = encoded(name, in_bits(picture(name), bits))
        assert_same(read(raw(name, numbers), bits), name, tolerance(name))
        assert_same(read(raw(name, numbers, padding=0, big=True), bits), name, tolerance(name))


@pytest.mark.parametrize("name", [name for name in PICTURES if name not in YUV])
def test_a_file_holds_the_numbers_of_its_encoding(name: str) -> None:
    for bits in (12, 16) if PICTURES[name].depth == 16 else (8,):
        numbers = encoded(name, in_bits(picture(name), bits))
        assert_same(read(compressed(f"{name}; png compressed ", numbers), bits), name, tolerance(name))
    if PICTURES[name].depth == 8 and PICTURES[name].channels != 4:
        assert_same(read(compressed(f"{name}; jpeg compressed ", numbers, ".jpg")), name, 12)


@pytest.mark.parametrize("name", [n for n in PICTURES if n in YUV or n.startswith(("rgb", "bgr"))])
def test_a_layout_named_last_is_that_of_the_file(name: str) -> None:
    """As compressed_image_transport converts colours before it compresses them."""
    bits = 16 if name.endswith("16") else 8
    numbers = encoded(f"bgr{bits}", in_bits(SCENE, bits))
    assert_same(read(compressed(f"{name}; png compressed bgr{bits}", numbers), bits), name, 0)
    in_jpeg = compressed(f"{name}; jpeg compressed bgr8", encoded("bgr8", SCENE), ".jpg")
    assert_same(read(in_jpeg, bits), name, 12)


@pytest.mark.parametrize("form", ["", *CODECS, "PNG", "image/png", "png compressed"])
def test_a_format_without_an_encoding_is_what_files_hold(form: str) -> None:
    suffix = "." + (form.lower().removeprefix("image/").split() or ["png"])[0]
    assert_same(read(compressed(form, encoded("bgr8", SCENE), suffix)), "rgb8", 12)
    assert_same(read(compressed(form, GREY[..., :1], suffix)), "mono8", 12)


def test_a_file_of_another_number_of_channels_is_what_it_holds() -> None:
    """A driver that names the encoding of its sensor, and sends colours."""
    assert_same(read(compressed("bayer_rggb8; png compressed ", encoded("bgr8", SCENE))), "rgb8", 0)
    assert_same(read(compressed("rgb8; png compressed bgr8", GREY[..., :1])), "mono8", 0)
    assert_same(read(compressed("bayer_rggb8; png compressed bgr8", encoded("bayer_rggb8", SCENE))), "bayer_rggb8", 2)


@pytest.mark.parametrize("message", [raw("mono16", in_bits(GREY[..., :1], 12)),
                                     compressed("mono16; png compressed ", in_bits(GREY[..., :1], 12))])  # fmt: skip
def test_sixteen_bits_ask_how_many_of_them_are_used(message: object) -> None:
    pixels = pixels_of(message, "/image")
    with pytest.raises(LogError, match=r"'front' has images of 16 bits without cameras\.front\.bits.*bits = 12, or"):
        in_eight_bits(pixels, camera(0))
    with pytest.raises(LogError, match=r"/image.*: 'front' has values up to \d+, and .*bits = 10; cameras.*bits = 12"):
        in_eight_bits(pixels, camera(10))
    assert in_eight_bits(pixels, camera(12)).max() == GREY.max()
    # A dark image of the same camera stays dark.
    assert in_eight_bits(pixels // 8, camera(12)).max() == GREY.max() // 8


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("16UC1", "are depth or other numbers and no picture; remove the camera"), ("8UC2", "are depth or other"),
        ("64FC4", "are depth or other"), ("yuv411", "is not supported; record one of: rgb8, "), ("", "is not"),
    ],
)  # fmt: skip
def test_what_is_no_picture_is_refused_by_its_name(name: str, why: str) -> None:
    for message in [raw(name, GREY), *([compressed(f"{name}; png compressed ", GREY)] if name else [])]:
        with pytest.raises(LogError, match=f"topic '/image' holds images encoded as '{name}', which {why}"):
            pixels_of(message, "/image")


@pytest.mark.parametrize(
    ("form", "why"),
    [
        ("16UC1; compressedDepth png", "are depth and no picture"),
        ("32FC1; compressedDepth", "are depth and no picture"),
        ("h264", f"is not supported; record one of: {', '.join(CODECS)}"),
        ("rgb8; theora", "is not supported"),
        ("mono16; jpeg compressed ", "cut 16 bits to their lower 8; record png"),
    ],
)
def test_formats_that_hold_no_picture_are_refused(form: str, why: str) -> None:
    with pytest.raises(LogError, match=f"topic '/image' holds images compressed as '{form}', which {why}"):
        pixels_of(compressed(form, GREY[..., :1], ".jpg"), "/image")


@pytest.mark.parametrize("name", PICTURES)
def test_data_that_does_not_fill_the_image_is_damaged(name: str) -> None:
    message = raw(name, encoded(name, in_bits(picture(name), PICTURES[name].depth)))
    message.data = message.data[:-30]
    assert pixels_of(message, "/image") is None
    message.height = 0
    assert pixels_of(message, "/image") is None
