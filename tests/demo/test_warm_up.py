"""Parts of `offpiste warm-up` run, and what goes wrong is said."""

from pathlib import Path

import pytest

from offpiste.core.errors import RunError
from offpiste.demo.first_minute import shipped
from offpiste.demo.warm_up import PLAN, RECORD, rehearse, rehearse_part


@pytest.mark.parametrize("part", [RECORD, PLAN])
def test_each_part_is_done(part: str, tmp_path: Path) -> None:
    assert rehearse_part(part, lambda share: None, run=shipped("dc"), folder=tmp_path) == part
    assert (tmp_path / "drive.mcap").exists() == (part == RECORD)


def test_what_goes_wrong_is_said() -> None:
    with pytest.raises(RunError, match="no pretrained model 'proving-ground/none'"):
        rehearse(shipped("none"), 1)
