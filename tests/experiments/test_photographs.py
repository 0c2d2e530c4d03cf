"""The eight photographs beside the project: trail and vegetation separate in features of images never fitted on."""

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from experiments.photographs import fit_on_photographs, main, read_photographs
from offpiste.errors import PerceptionError
from offpiste.perception.backbones import open_backbone
from offpiste.perception.feature_extractor import FeatureExtractor

TRAIL = {
    "run0": [(440, 300, 900, 470)],
    "run1": [(400, 230, 560, 330)],
    "run11": [(20, 260, 1000, 470)],
    "run3": [(420, 260, 590, 340), (350, 370, 720, 470)],
    "run4": [(420, 200, 600, 300), (300, 330, 800, 470)],
    "run8": [(100, 320, 900, 480)],
}
"""Bare ground that the vehicle would drive on: left, top, right, bottom [px]; chosen by eye before any result."""
VEGETATION = {
    "run0": [(50, 90, 370, 180), (0, 200, 380, 240)],
    "run1": [(660, 290, 1000, 460), (760, 130, 1000, 200)],
    "run11": [(300, 60, 700, 130)],
    "run2": [(100, 240, 950, 470)],
    "run3": [(20, 230, 250, 440), (700, 190, 1000, 310)],
    "run4": [(20, 60, 350, 170), (780, 200, 1000, 320)],
    "run5": [(0, 170, 300, 450), (600, 60, 1000, 240)],
    "run8": [(20, 30, 400, 150), (880, 250, 1000, 330)],
}


def patches(look: np.ndarray, extractor: FeatureExtractor, shape: tuple[int, ...], boxes) -> np.ndarray:
    """Features of the patches whose middle lies in one of the boxes."""
    grid = extractor.backbone.grid(shape[1], shape[0])
    row, column = np.mgrid[: grid.rows, : grid.columns]
    x, y = (grid.offset[axis] + (index + 0.5) * grid.size for axis, index in enumerate((column, row)))
    inside = np.zeros(x.shape, bool)
    for left, top, right, bottom in boxes:
        inside |= (x >= left) & (x < right) & (y >= top) & (y < bottom)
    return look[inside]


def linear_discriminant(trail: list[np.ndarray], vegetation: list[np.ndarray]) -> tuple[np.ndarray, float]:
    """Fisher's, every image of a class weighing the same; positive on the trail."""
    means, scatter = [], 0.0
    for parts in (trail, vegetation):
        mean = np.mean([p.mean(axis=0) for p in parts], axis=0)
        scatter = scatter + np.mean([(p - mean).T @ (p - mean) / len(p) for p in parts], axis=0)
        means.append(mean)
    direction = np.linalg.solve(scatter + 1e-6 * np.eye(len(scatter)), means[0] - means[1])
    return direction, float(direction @ (means[0] + means[1]) / 2)


def held_out_accuracy(photographs, components: int) -> tuple[dict[str, float], dict[str, float]]:
    """Share of trail and of vegetation patches of each image that the seven others classify correctly."""
    backbone = open_backbone("filterbank")
    trail_right, vegetation_right = {}, {}
    for held_out in photographs:
        extractor = fit_on_photographs(
            [p for n, p in photographs.items() if n != held_out], backbone, components=components
        )
        found = {}
        for name, photograph in photographs.items():
            look = extractor.extract(photograph).astype(np.float64)
            shape = photograph.shape
            found[name] = [patches(look, extractor, shape, boxes.get(name, ())) for boxes in (TRAIL, VEGETATION)]
        known = [found[name] for name in photographs if name != held_out]
        direction, threshold = linear_discriminant(
            [trail for trail, _ in known if len(trail)], [vegetation for _, vegetation in known if len(vegetation)]
        )
        trail, vegetation = found[held_out]
        if len(trail):
            trail_right[held_out] = float((trail @ direction > threshold).mean())
        vegetation_right[held_out] = float((vegetation @ direction <= threshold).mean())
    return trail_right, vegetation_right


@pytest.fixture(scope="module")
def folder(data_folder):
    folder = data_folder / "tartandrive2" / "images"
    if not folder.is_dir():
        pytest.skip(f"no photographs: {folder}")
    return folder


def test_trail_and_vegetation_separate_in_an_image_never_seen(folder):
    """Texture and colour alone take a heap of stones (run8) for brush, and the brightest grass (run2) for gravel."""
    trail, vegetation = held_out_accuracy(read_photographs(folder), 20)
    balanced = (np.mean(list(trail.values())) + np.mean(list(vegetation.values()))) / 2
    print(f"balanced {balanced:.3f}", trail, vegetation)
    assert balanced > 0.75
    assert min(trail[name] for name in ("run0", "run1", "run3", "run4")) > 0.9
    assert min(vegetation[name] for name in ("run0", "run1", "run4", "run5", "run8", "run11")) > 0.9


def test_one_of_the_colours_drawn_tells_trail_from_vegetation(folder):
    photographs = read_photographs(folder)
    extractor = fit_on_photographs(list(photographs.values()), open_backbone("filterbank"), components=3)
    areas = {}
    for name in TRAIL:
        look, shape = extractor.extract(photographs[name]), photographs[name].shape
        trail, vegetation = (patches(look, extractor, shape, boxes[name]) for boxes in (TRAIL, VEGETATION))
        # Area under the ROC curve: how often a trail patch lies above one of vegetation.
        above = [mannwhitneyu(t, v).statistic / len(t) / len(v) for t, v in zip(trail.T, vegetation.T, strict=True)]
        areas[name] = max(max(a, 1 - a) for a in above)
    print("areas", areas)
    assert min(areas.values()) > 0.85


def test_pictures_are_written_beside_each_other(tmp_path, folder):
    main(folder, tmp_path / "out")
    drawn = read_photographs(tmp_path / "out")
    assert drawn["run4"].shape == (544, 2048, 3)
    np.testing.assert_array_equal(drawn["run4"][:, :1024], read_photographs(folder)["run4"])
    assert drawn["run4"][20:-20, 1040:-20].std(axis=(0, 1)).min() > 20


def test_what_is_no_picture_ends_in_one_line(tmp_path):
    with pytest.raises(PerceptionError, match="no pictures"):
        read_photographs(tmp_path)
    (tmp_path / "x.png").write_text("")
    with pytest.raises(PerceptionError, match="not a picture"):
        read_photographs(tmp_path)
