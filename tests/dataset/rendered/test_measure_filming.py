"""`scripts/measure_filming.py`."""

import io

import av
import numpy as np
import pytest

import measure_filming as filming
from lemma.core.workers.serial import Serial
from lemma.tasks.suite import load_instance


@pytest.mark.render
def test_filming_is_timed_by_stages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(filming, "ProcessPool", lambda workers: Serial())
    instances = [load_instance("pass", "val", 0)]
    (found,) = filming.measure_filming(instances, 1, ((32, 32),), least_s=0.01)
    stages = found.replay_ms / 2 + found.render_ms + found.encode_ms
    assert found.images_per_s == pytest.approx(1000.0 / stages)
    assert found.all_minutes == pytest.approx(5e4 / found.images_per_s)
    assert (found.renderer, found.width, found.height) == ("opengl", 32, 32)


def test_videos_hold_what_was_encoded() -> None:
    rng = np.random.default_rng(0)
    frames = np.repeat(rng.integers(0, 255, (5, 1, 1, 3), np.uint8), 32, axis=1)
    frames = np.repeat(frames, 48, axis=2)
    with av.open(io.BytesIO(filming.encode(frames, 10)), "r") as container:
        images = [one.to_ndarray(format="rgb24") for one in container.decode(video=0)]
    assert np.shape(images) == frames.shape
    assert np.abs(np.array(images, np.int16) - frames).max() < 12
