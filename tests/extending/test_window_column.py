"""A window column of an extension: from the log to batches and to the history of a planner."""

import numpy as np
import pytest

from extending.outside import CAR, extracted_car, succeeded
from offpiste.core.errors import RigError
from offpiste.rig.rig import parse_rig

CHANNEL = 'temperature = { fields = ["air"], unit = "degC" }\n'

GATHER = """
import sys
import numpy as np
from offpiste.dataset.store import open_dataset
from offpiste.dataset.windows import Windows
from offpiste.evaluation.evaluated_windows import EvaluatedWindows
from offpiste.runtime.estimator import VehicleReading, VehicleTrack

dataset = open_dataset(sys.argv[1])
windows = Windows(dataset, "train")
batch = windows.gather(np.arange(len(windows)))
time, row = dataset.drives[0].rows.time, windows.rows
np.testing.assert_allclose(batch.extra["temperature"]["start"], 20 + 0.1 * time[row], atol=1e-4)
np.testing.assert_allclose(batch.history.extra["temperature"][:, 0], 20 + 0.1 * time[row - 10], atol=1e-4)
assert list(batch.extra["temperature"]) == ["past", "start"]
evaluated = EvaluatedWindows(dataset, 0 * row, row)
np.testing.assert_allclose(evaluated.at_start("temperature"), 20 + 0.1 * time[row], atol=1e-4)

track = VehicleTrack()
for number in range(50):
    level, still = np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3)
    more = {"temperature": 20.0 + number} if number != 45 else {}
    track.add(VehicleReading(0.02 * number, still, level, still, 0.0, np.full(4, np.nan), more))
found = track.rows(0.02 * 49).extra["temperature"]
np.testing.assert_array_equal(found, [np.nan if n == 45 else 20.0 + n for n in range(39, 50)])
print(len(windows), "windows")
"""


def test_an_added_column_goes_from_the_log_into_batches_and_histories(tmp_path):
    time = np.arange(0, 10, 0.02)
    dataset = extracted_car(tmp_path, CHANNEL, extension="temperature", air=20 + 0.1 * time)
    assert int(succeeded("-c", GATHER, dataset, extension="temperature").split()[0]) > 100


def test_without_the_extension_the_channel_is_refused():
    with pytest.raises(RigError, match="unknown channel 'temperature'"):
        parse_rig(CAR + CHANNEL, where="rig.toml")
