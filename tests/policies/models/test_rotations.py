"""Cells, yaws, crops and correlation: geometry that must be exact."""

import math

import pytest
import torch
from batches import RASTER
from torch.nn import functional as F

from lemma.policies.models.grid import (
    Cells,
    bin_yaws,
    correlate,
    crop_about,
    nearest_bins,
    read_at,
    turned,
    wrapped,
    yaw_of,
)
from lemma.scene.raster import Raster

SMALL = Raster(rows=32, columns=48, cell_m=0.01, floor_m=-0.1)


def spot(raster: Raster, x: float, y: float) -> torch.Tensor:
    """Return a map that is 1 in the cell of a position."""
    image = torch.zeros(1, 1, raster.rows, raster.columns)
    row, column = raster.pixel_from_world(x, y)
    image[0, 0, row, column] = 1.0
    return image


@pytest.mark.parametrize("stride", [1, 2, 4])
def test_positions_survive_cells_and_offsets(stride: int) -> None:
    cells = Cells.of(RASTER, stride)
    xy = (torch.rand(200, 2, generator=torch.Generator().manual_seed(0)) - 0.5) * 1.5
    numbers = cells.holding(xy)
    offsets = cells.offsets(xy, numbers)
    assert offsets.abs().max() <= 0.5 + 1e-4
    assert torch.allclose(cells.positions(numbers, offsets), xy, atol=1e-6)


def test_cells_agree_with_the_raster() -> None:
    cells = Cells.of(RASTER, 1)
    x, y = RASTER.world_from_pixel(7, 80)
    number = cells.holding(torch.tensor([x, y]))
    assert number == 7 * RASTER.columns + 80
    assert cells.centres(number).tolist() == pytest.approx([x, y], abs=1e-6)


def test_what_lies_outside_belongs_to_the_nearest_cell() -> None:
    cells = Cells.of(RASTER, 4)
    assert cells.holding(torch.tensor([-9.0, 9.0])) == 0
    assert cells.holding(torch.tensor([9.0, -9.0])) == len(cells) - 1


def test_nine_cells_lie_around_one() -> None:
    cells = Cells(5, 7, 0.1)
    around = cells.around(torch.tensor([2 * 7 + 3, 0]))
    assert around[0].tolist() == [9, 10, 11, 16, 17, 18, 23, 24, 25]
    assert set(around[1].tolist()) == {0, 1, 7, 8}
    assert around[1, 4] == 0


def test_features_are_read_where_they_are() -> None:
    features = torch.arange(2 * 3 * 4 * 5).view(2, 3, 4, 5)
    read = read_at(features, torch.tensor([[7, 0], [19, 3]]))
    assert read[0, 0].tolist() == features[0, :, 1, 2].tolist()
    assert read[1, 0].tolist() == features[1, :, 3, 4].tolist()


@pytest.mark.parametrize("bins", [1, 12, 36])
def test_yaw_survives_either_of_its_bins(bins: int) -> None:
    yaw = torch.linspace(-7.0, 7.0, 500)
    both, rests = nearest_bins(yaw, bins)
    assert both.min() >= 0
    assert both.max() < bins
    assert rests[:, 0].abs().max() <= 0.5
    assert rests.abs().max() <= 1.0
    for i in range(2):
        error = wrapped(yaw_of(both[:, i], rests[:, i], bins) - yaw)
        assert error.abs().max() < 1e-4


@pytest.mark.parametrize("yaw", [0.0, 0.5 * math.pi, 2.0, -2.6])
def test_a_crop_shows_what_lies_ahead_to_the_right_of_its_middle(yaw: float) -> None:
    x, y = 0.03, -0.04
    ahead, left = 0.08, 0.03
    at_x = x + math.cos(yaw) * ahead - math.sin(yaw) * left
    at_y = y + math.sin(yaw) * ahead + math.cos(yaw) * left
    crop = crop_about(
        spot(SMALL, at_x, at_y),
        torch.tensor([[x, y, yaw]]),
        SMALL,
        24,
        24 * SMALL.cell_m,
    )
    row, column = divmod(int(crop.argmax()), 24)
    assert (column + 0.5 - 12) * 0.01 == pytest.approx(ahead, abs=0.0101)
    assert (12 - row - 0.5) * 0.01 == pytest.approx(left, abs=0.0101)


def test_outside_the_map_there_is_nothing() -> None:
    image = torch.ones(1, 2, SMALL.rows, SMALL.columns)
    assert (
        crop_about(image, torch.tensor([[5.0, 5.0, 1.0]]), SMALL, 8, 1.0).abs().max()
        == 0
    )


@pytest.mark.parametrize("size", [8, 9])
def test_turning_is_counter_clockwise(size: int) -> None:
    image = torch.zeros(1, 1, size, size)
    image[0, 0, size // 2 - 1 : size // 2 + 1, size - 2] = 1.0
    found = turned(image, bin_yaws(4))
    assert found.shape == (1, 4, 1, 9, 9)
    peaks = [divmod(int(f.argmax()), 9) for f in found[0, :, 0]]
    for (row, column), (up, right) in zip(
        peaks, [(0, 1), (1, 0), (0, -1), (-1, 0)], strict=True
    ):
        assert (4 - row) * up + (column - 4) * right >= 2
        assert abs((4 - row) * right + (column - 4) * up) <= 1


def correlate_directly(key: torch.Tensor, kernels: torch.Tensor) -> torch.Tensor:
    """Do what correlate does by sliding kernels: the definition."""
    count, rotations, channels, side, _ = kernels.shape
    found = F.conv2d(
        key.reshape(1, count * channels, *key.shape[-2:]),
        kernels.reshape(count * rotations, channels, side, side),
        padding=side // 2,
        groups=count,
    )
    return found.view(count, rotations, *key.shape[-2:])


def test_spectra_and_sliding_agree() -> None:
    generator = torch.Generator().manual_seed(1)
    key = torch.randn(3, 2, 11, 17, generator=generator)
    kernels = torch.randn(3, 4, 2, 7, 7, generator=generator)
    fast, slow = correlate(key, kernels), correlate_directly(key, kernels)
    assert fast.shape == (3, 4, 11, 17)
    assert torch.allclose(fast, slow, atol=1e-4)


def test_kernels_larger_than_the_map_do_not_wrap_around() -> None:
    generator = torch.Generator().manual_seed(2)
    key = torch.randn(1, 2, 5, 6, generator=generator)
    kernels = torch.randn(1, 2, 2, 9, 9, generator=generator)
    assert torch.allclose(
        correlate(key, kernels), correlate_directly(key, kernels), atol=1e-4
    )


def test_a_kernel_fits_where_the_pose_is_that_sees_the_spot() -> None:
    """Crop, turn and correlation together: geometry of the whole transport."""
    pick = torch.tensor([[0.05, -0.02, 0.7]])
    seen = spot(SMALL, 0.05 + math.cos(0.7) * 0.06, -0.02 + math.sin(0.7) * 0.06)
    kernels = turned(crop_about(seen, pick, SMALL, 16, 16 * SMALL.cell_m), bin_yaws(4))
    # The spot is 6 cm ahead of the gripper. With a yaw of a quarter turn, it is ahead
    # of the gripper if that stands 6 cm below it.
    fits = correlate(spot(SMALL, -0.1, 0.05), kernels)[0, 1]
    row, column = divmod(int(fits.argmax()), SMALL.columns)
    x, y = SMALL.world_from_pixel(row, column)
    assert (x, y) == pytest.approx((-0.1, -0.01), abs=0.0101)
