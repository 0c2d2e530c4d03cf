"""A KITTI raw drive without images and scans: OXTS rows, stamps and calibration."""

from pathlib import Path

import numpy as np

CALIBRATION = {
    "calib_imu_to_velo.txt": "R: 1 0 0 0 1 0 0 0 1\nT: -1 0 -2\n",
    "calib_velo_to_cam.txt": "calib_time: 09-Jan-2012 13:57:47\nR: 0 -1 0 0 0 -1 1 0 0\nT: 0 0 -0.5\n",
    "calib_cam_to_cam.txt": "R_rect_00: 1 0 0 0 1 0 0 0 1\n",
}


def kitti_drive(day: Path, frames: int, step: float, calibration: str) -> Path:
    """Write a drive to the north and uphill, 1 m each a frame, every `step` s; append the calibration of camera 2."""
    drive = day / "drive_sync"
    for folder in ("oxts", "image_02", "velodyne_points"):
        (drive / folder / "data").mkdir(parents=True)
        for edge, late in (("", 0.0), ("_start", -0.05), ("_end", 0.05)):
            stamps = [f"2011-09-26 13:10:{10.5 + frame * step + late:012.9f}\n" for frame in range(frames)]
            (drive / folder / f"timestamps{edge}.txt").write_text("".join(stamps))
    for frame in range(frames):
        row = [49.0 + frame * 1e-5, 8.0, 100.0 + frame, 0, 0, np.pi / 2, *24 * [0.0]]
        (drive / "oxts" / "data" / f"{frame:010d}.txt").write_text(" ".join(map(str, row)))
    for name, text in CALIBRATION.items():
        (day / name).write_text(text + (calibration if name == "calib_cam_to_cam.txt" else ""))
    return drive
