"""Images to codes: backbone, PCA and encoder, of each camera's keyframes."""

import time

from offpiste.core.errors import PerceptionError
from offpiste.live.packing import image_from, packed, unpacked
from offpiste.live.part import Part, TrackFeed, keep_loaded
from offpiste.live.parts.setup import load_kernels, wait_for_sensors
from offpiste.live.session import Session
from offpiste.logs.measurements import Image
from offpiste.mapping.replay import Keyframes
from offpiste.runtime.perception import codes_of, encoder_on


def codes(session: Session) -> None:
    """The process that extracts features."""
    part = Part("codes", session)
    device = part.settings.runtime.device
    planner = part.settings.load_planner(device)
    load_kernels(part, planner)  # on the CPU, since it plans nothing; the extractor is on the device
    setup = wait_for_sensors(part, planner)
    if setup is None or planner.extractor is None:
        return
    encoder = encoder_on(device, planner.dynamics.eval().requires_grad_(False).encoder)
    assert encoder is not None
    keep_loaded()
    waiting: dict[str, Image] = {}  # the newest of each camera, until the pose is known
    feed, number = TrackFeed(part, planner.dynamics.vehicle.actuators), part.ring("images").written
    keyframes, took = Keyframes(setup.cameras, part.settings.runtime.replay), 0.0
    while not part.ending:
        if feed.update(part.now()):
            keyframes = Keyframes(setup.cameras, part.settings.runtime.replay)
            waiting.clear()
        for entry in part.ring("images").since(number):
            part.dropped["images: overwritten"] += entry.number - number - 1
            number, image = entry.number, image_from(unpacked(entry.data))
            part.dropped["images: replaced by a newer one"] += image.camera in waiting
            if not feed.intake.ahead(image.camera, image.time):
                waiting[image.camera] = image
        due = [image for image in waiting.values() if not feed.track.awaits(image.time)]
        for image in due:
            del waiting[image.camera]
            pose = feed.track.pose_at(image.time)
            if pose is None or image.camera not in setup.cameras:
                part.dropped["images: stamped when the pose is not known"] += 1
                continue
            found = None
            if keyframes.due(image, pose):
                began = time.monotonic()
                try:
                    pixels = setup.cameras[image.camera].rectifier(image.pixels)
                    found = codes_of(pixels, planner.extractor.extract, encoder)
                except PerceptionError as error:
                    part.dropped[f"images: {error.what}"] += 1
                    continue
                took = time.monotonic() - began
                keyframes.add(image.camera, image.time, pose, found, image.pixels[:0])
            part.hand_on("codes", packed({"camera": image.camera, "time": image.time, "codes": found}))
        part.beat("ready", extract_ms=1e3 * took)
        if not due:
            time.sleep(0.01)
