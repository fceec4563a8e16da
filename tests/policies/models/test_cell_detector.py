"""Cells: a network learns what they have, and a probe finds what they tell."""

from pathlib import Path

import pytest
import torch
from batches import RASTER, drawn_batch, labels_of
from hypothesis import given
from hypothesis import strategies as st
from tiny_models import tiny

from lemma.policies.models.catalog import options_of
from lemma.policies.models.cell_detector import CellDetector
from lemma.policies.models.episodic_transformer import EpisodicTransformer
from lemma.policies.weights_file import WeightsMetadata, load_weights, write_weights
from lemma.scene.objects.palette import OBJECT_COLORS
from probe_frames import Seen, ask

SIDE = 7


def told(
    rows: list[int], columns: list[int], inside: list[list[float]]
) -> CellDetector:
    """Return a detector that is sure of a cell for each entity; row -1 is absence."""
    detector = CellDetector(1, len(rows))
    shares = torch.full((1, len(rows), SIDE * SIDE + 1), -50.0)
    places = torch.full((1, len(rows), SIDE * SIDE, 2), 0.5)
    for entity, (row, column) in enumerate(zip(rows, columns, strict=True)):
        number = row * SIDE + column if row >= 0 else SIDE * SIDE
        shares[0, entity, number] = 0.0
        places[0, entity, number % (SIDE * SIDE)] = torch.tensor(inside[entity])
    detector.forward = lambda features: (shares, places)  # type: ignore[method-assign]
    return detector


@given(st.integers(0, 63), st.integers(0, 95))
def test_nothing_is_lost_where_an_entity_is(row: int, column: int) -> None:
    x, y = RASTER.world_from_pixel(row, column)
    objects = torch.tensor([[[x, y, 0.0], [torch.nan] * 3]])
    at = [(column + 0.5) / RASTER.columns * SIDE, (row + 0.5) / RASTER.rows * SIDE]
    here, there = int(at[1]), int(at[0])
    features = torch.zeros(1, SIDE * SIDE, 1)
    fraction = [at[0] % 1.0, at[1] % 1.0]

    def lost(rows: list[int], inside: list[float]) -> float:
        detector = told(rows, [there, 0], [inside, [0.5, 0.5]])
        return detector.loss(features, objects, RASTER).item()

    assert lost([here, -1], fraction) == pytest.approx(0.0, abs=1e-4)
    assert lost([(here + 1) % SIDE, -1], fraction) > 10.0
    assert lost([here, 0], fraction) > 10.0
    off = [fraction[0], fraction[1] + 0.2]
    assert lost([here, -1], off) == pytest.approx(0.1, abs=1e-3)


def test_the_image_network_learns_where_things_are() -> None:
    batch = drawn_batch(3)
    model = tiny("episodic-transformer", channels=(16, 16))
    optimiser = torch.optim.Adam(model.parameters(), 5e-3)
    for _ in range(250):
        loss = torch.stack(list(model.loss(batch).values())).sum()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    objects = labels_of(batch).objects
    shares, _ = model.detector(model._each(model._cells(batch)))
    found, there = shares.argmax(2), objects[..., 0].isfinite()
    assert torch.equal(found < SIDE * SIDE, there)
    row, column = found[there] // SIDE, found[there] % SIDE
    x_m, y_m = RASTER.size_m
    middle = torch.stack([(column + 0.5) / SIDE - 0.5, 0.5 - (row + 0.5) / SIDE], 1)
    off = (objects[there][:, :2] / torch.tensor([x_m, y_m]) - middle).abs() * SIDE
    # Half a cell at most, or one more where pooled cells share pixels.
    assert (off <= 1.5).all()
    without = tiny("episodic-transformer", detection=0.0)
    assert "detection" not in without.loss(batch)
    assert not hasattr(without, "detector")


def test_weights_from_before_detection_load_as_they_were(tmp_path: Path) -> None:
    model = tiny("episodic-transformer", detection=0.0)
    options = {k: v for k, v in options_of(model).items() if k != "detection"}
    about = WeightsMetadata(
        model="episodic-transformer",
        options=options,
        data={},
        command="",
        scores={},
        training={},
        lemma="",
    )
    write_weights(tmp_path / "old.safetensors", model.state_dict(), about)
    loaded = load_weights(tmp_path / "old.safetensors")
    assert isinstance(loaded, EpisodicTransformer)
    assert loaded.config.detection == 0.0


def test_the_probe_finds_what_cells_tell_of_a_color_and_nothing_else() -> None:
    torch.manual_seed(1)
    count = len(OBJECT_COLORS)
    seen = []
    for _ in range(500):
        cells = torch.randn(3 * count)
        chance = torch.randn(count)
        told, unknown = (
            [(torch.eye(count)[n], bool(numbers[n] > 0)) for n in range(count)]
            for numbers in (cells, chance)
        )
        seen.append(Seen(cells, {"told": told, "unknown": unknown}))
    common, right = ask(seen, "told")
    assert common < 0.6 < 0.9 < right
    common, right = ask(seen, "unknown")
    assert common < 0.6
    assert right < 0.6
