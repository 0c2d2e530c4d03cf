"""The kept epoch: in words, with what speaks against it."""

import json

import pytest

from offpiste.training.kept_epoch import KeptEpoch


@pytest.mark.parametrize(
    ("epoch", "line", "doubt"),
    [
        (7, "model: kept epoch 7 of 12, validation 0.6251", None),
        (12, "model: kept epoch 12 of 12, validation 0.6251", "the kept epoch is the last one"),
        (1, "model: kept epoch 1 of 12, validation 0.6251", "the kept epoch is the first one"),
        (0, "model: kept the weights that it began with, validation 0.6251: no epoch of 12 was better", None),
        (None, "model: kept its best epoch, validation 0.6251", None),
    ],
)
def test_an_epoch_in_words(epoch: int | None, line: str, doubt: str | None) -> None:
    kept = KeptEpoch(epoch, 12, 0.62512)
    assert kept.line("model") == line
    found = list(kept.doubts("model"))
    assert len(found) == (doubt is not None)
    assert doubt is None or doubt in found[0]


def test_a_stage_of_one_epoch_is_not_doubted() -> None:
    assert not list(KeptEpoch(1, 1, 0.5).doubts("model"))


def test_files_of_before_do_not_say_which_epoch() -> None:
    assert KeptEpoch.of({"validation_loss": 0.5}, 3) == KeptEpoch(None, 3, 0.5, 0.0)
    assert KeptEpoch.of({"validation_loss": 0.5, "kept_epoch": 2}, 3) == KeptEpoch(2, 3, 0.5, 0.0)


@pytest.mark.parametrize("losses", [[1.0, 0.5, 0.4999, 0.4998, 0.4997], [1.0, 0.9, 0.8, 0.7, 0.6], [1.0, 0.5]])
def test_a_stage_that_is_read_back_is_doubted_as_it_was(losses: list[float]) -> None:
    fresh = KeptEpoch.last_of(len(losses), losses, len(losses), losses[-1])
    again = KeptEpoch.of(json.loads(json.dumps(fresh.about())), len(losses))
    assert again == fresh
    assert list(again.doubts("bicycle")) == list(fresh.doubts("bicycle"))


@pytest.mark.parametrize(("stage", "option"), [("model", "--epochs"), ("bicycle", "--bicycle-epochs")])
def test_the_option_of_the_epochs_that_are_few_is_named(stage: str, option: str) -> None:
    (doubt,) = KeptEpoch(12, 12, 0.5).doubts(stage)
    assert doubt.endswith(f"with more than 12 {option}")


def test_actuators_are_not_doubted() -> None:
    """What they still gain, no model shows."""
    assert not list(KeptEpoch(8, 8, 0.02).doubts("actuators"))


def test_epochs_that_hardly_gain_have_converged() -> None:
    falling = KeptEpoch.last_of(6, [1.0, 0.9, 0.8, 0.7, 0.6, 0.5], 6, 0.5)
    assert falling.gained == pytest.approx(1 - 0.5 / 0.8)
    assert list(falling.doubts("model"))
    still = KeptEpoch.last_of(6, [1.0, 0.5002, 0.5002, 0.5001, 0.5001, 0.5], 6, 0.5)
    assert not list(still.doubts("model"))
    assert KeptEpoch.last_of(2, [1.0, 0.5], 2, 0.5).gained is None
