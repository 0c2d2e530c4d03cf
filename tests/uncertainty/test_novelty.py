"""Novel ground: detected by distance from training features, and encoded as missing."""

import pytest
import torch

from factories import VEHICLE, drawn, unsettled
from offpiste.core.errors import DatasetError
from offpiste.dynamics.feature_encoder import Compressor
from offpiste.training.run import build
from offpiste.uncertainty.novelty import NoveltyMask, fit_memory_bank, mask_novel_ground


def ground(count: int, seed: int) -> torch.Tensor:
    """Two kinds of ground, which look apart in the first feature; the other features are noise."""
    drawn = torch.randn(count, 4, generator=torch.Generator().manual_seed(seed))
    drawn[:, 0] += torch.where(torch.arange(count) % 2 == 0, -10.0, 10.0)
    return drawn


def test_ground_between_known_kinds_is_novel_and_the_quantile_sets_the_threshold():
    bank = fit_memory_bank(ground(4000, 0), ground(1000, 1))
    novel = ground(1000, 2)
    novel[:, 0] = torch.randn(1000, generator=torch.Generator().manual_seed(3))
    assert bank.novel(ground(1000, 4)).float().mean() < 0.03
    assert bank.novel(novel).float().mean() > 0.97, "their mean is that of all, but none looks like it"
    assert bank.novel(ground(1000, 1)).float().mean() == pytest.approx(0.01, abs=0.001)
    with pytest.raises(DatasetError, match="2 cells of ground for training"):
        fit_memory_bank(ground(2, 0), ground(50, 1))


def test_the_distance_is_the_mean_to_the_nearest_features():
    training, other = ground(50, 0), ground(20, 1)
    bank = fit_memory_bank(training, ground(20, 2))
    apart = (other[:, None] - training).double().square().sum(dim=-1).sqrt().sort(dim=1).values
    found = bank.distance(other).double()
    torch.testing.assert_close(found, apart[:, :3].mean(dim=1), rtol=1e-3, atol=1e-3)


def test_a_masking_encoder_encodes_novel_cells_as_missing_and_no_others():
    encoder = unsettled(Compressor(4))
    masking = NoveltyMask(encoder, fit_memory_bank(ground(4000, 0), ground(1000, 1)))
    features, valid = ground(100, 4), drawn(100) > -0.5
    features[40:60, 0] = 0.0
    features[~valid] = torch.nan
    novel = torch.zeros(100, dtype=torch.bool)
    novel[valid] = masking.bank.novel(features[valid])
    assert novel[40:60][valid[40:60]].all()
    codes = masking(features, valid)
    torch.testing.assert_close(codes[novel | ~valid], encoder.missing().expand(int((novel | ~valid).sum()), -1))
    torch.testing.assert_close(codes[valid & ~novel], encoder(features, valid)[valid & ~novel])
    torch.testing.assert_close(masking.missing(), encoder.missing())
    model = build("b", VEHICLE, seed=0)
    mask_novel_ground(model, masking.bank)
    assert model.encoder is None
