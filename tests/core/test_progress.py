"""Progress lines."""

from itertools import count

import pytest

from offpiste.core import progress


def test_long_work_is_told_every_15_seconds_and_quick_work_is_not(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    moments = count(0.0, 4.0)
    monkeypatch.setattr(progress, "monotonic", lambda: next(moments))
    assert list(progress.track(range(3), "quick")) == [0, 1, 2]
    assert list(progress.track(range(7), "check")) == list(range(7))
    list(zip(progress.track(count(), "trying remedies"), range(5), strict=False))
    with progress.jobs_bar(2, "extract") as update:
        for share in (0.2, 0.4):
            update(0, share)
            update(1, share / 2)
    assert capsys.readouterr().err.splitlines() == [
        "check: 3 of 7 (43%) after 16 s, 21 s left",
        "trying remedies: 3 after 16 s",
        "extract: 30% after 16 s, 37 s left",
    ]
