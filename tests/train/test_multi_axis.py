"""What the fit of a stage of several axes reports."""

import json

import pytest

from tests.stage.two_axes import recordings, two_axes
from train.multi_axis import judged, show


def test_a_recording_with_an_unbounded_response_is_reported_as_such(
    capsys: pytest.CaptureFixture[str],
) -> None:
    every = recordings(two_axes(), (0.3,), 1)
    metrics = {"train": judged(two_axes(), every), "heldout": judged(two_axes(force=30.0), every)}
    assert metrics["train"][0]["rms_um"] < 0.01
    assert json.loads(json.dumps(metrics))["heldout"][0]["rms_um"] is None
    show(metrics)
    assert "unbounded response, noise" in capsys.readouterr().out
