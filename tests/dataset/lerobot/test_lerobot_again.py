"""An export that is interrupted, repeated, or impossible; and what it is made of."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from in_process import Killed, KilledAfter, Serial
from lerobot_sets import STYLE, decode_at, folder, order, psnr_db
from rendered_sets import SPLIT, TASKS, contents, own_copy, recipe_folder

from lemma.core.errors import DatasetError, InvalidConfigError, UnknownNameError
from lemma.core.parallel import ProcessPool
from lemma.dataset.files import REVISION_VARIABLE
from lemma.dataset.lerobot.assembly import allot
from lemma.dataset.lerobot.export import LeRobotConfig, write_dataset
from lemma.dataset.lerobot.layout import Style
from lemma.dataset.lerobot.stats import Histogram, Total, describe
from lemma.dataset.lerobot.video import (
    DEPTH,
    DEPTH_LARGEST_M,
    RGB,
    Encoding,
    Film,
    join,
    levels_from_depth,
)
from lemma.dataset.recipe.generate import GenerateConfig, generate
from lemma.dataset.rendered.render import RenderConfig


@pytest.fixture(autouse=True)
def _one_revision(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(REVISION_VARIABLE, "of-the-tests")


@pytest.mark.render
def test_interrupted_or_not_the_bytes_are_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "set"
    with pytest.raises(Killed):
        write_dataset(order(out), KilledAfter(1))
    assert not (out / "meta/info.json").exists()
    joined = 0

    def join_some(*arguments: Any) -> None:
        nonlocal joined
        joined += 1
        if joined > 3:
            raise Killed
        join(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr("lemma.dataset.lerobot.assembly.join", join_some)
        with pytest.raises(Killed):
            write_dataset(order(out), Serial())
    assert len(list(out.rglob("file-*.mp4"))) == 3
    told: list[int] = []
    # Nothing is filmed again.
    summary = write_dataset(order(out), KilledAfter(0), told.append)
    assert (summary.made, told) == (0, [4])
    assert contents(out) == contents(folder())
    # Nor is anything done to what is whole.
    assert write_dataset(order(out), KilledAfter(0)).made == 0
    assert contents(out) == contents(folder())


@pytest.mark.render
@pytest.mark.slow
def test_several_processes_write_the_same_bytes(tmp_path: Path) -> None:
    assert write_dataset(order(tmp_path / "set"), ProcessPool(2)).made == 4
    assert contents(tmp_path / "set") == contents(folder())


@pytest.mark.render
def test_what_was_made_otherwise_is_not_mixed(tmp_path: Path) -> None:
    out = own_copy(folder(), tmp_path / "set")
    before = contents(out)
    with pytest.raises(DatasetError, match=r"fps is 2 there, and 5 here"):
        write_dataset(order(out, replace(STYLE, fps=5)), Serial())
    with pytest.raises(DatasetError, match=r"recipe is"):
        write_dataset(order(out, tasks=TASKS[:1]), Serial())
    assert contents(out) == before
    other = tmp_path / "other"
    other.mkdir()
    (other / "notes.txt").write_text("mine")
    with pytest.raises(DatasetError, match="did not begin"):
        write_dataset(order(other), Serial())


@pytest.mark.render
def test_a_lost_part_is_an_error(tmp_path: Path) -> None:
    out = tmp_path / "set"
    style = replace(STYLE, depth=False)
    with pytest.raises(Killed):
        write_dataset(order(out, style, tasks=TASKS[:1]), KilledAfter(1))
    next(out.rglob("*.mp4")).unlink()
    with pytest.raises(DatasetError, match="Delete the folder"):
        write_dataset(order(out, style, tasks=TASKS[:1]), Serial())


def test_names_of_tasks_and_splits_choose_episodes(tmp_path: Path) -> None:
    sources = order(tmp_path / "set", tasks=TASKS[:1]).sources()
    assert [source.path.stem for source in sources] == [TASKS[0]] * 2
    with pytest.raises(UnknownNameError, match="task in this recipe"):
        order(tmp_path / "set", tasks=("sleep",)).sources()
    with pytest.raises(UnknownNameError, match="split in this recipe"):
        order(tmp_path / "set", splits=("train",)).sources()


@pytest.mark.render
def test_a_recipe_that_was_changed_is_not_filmed(tmp_path: Path) -> None:
    recipe = own_copy(recipe_folder(), tmp_path / "recipe")
    path = recipe / SPLIT / f"{TASKS[0]}.parquet"
    content = bytearray(path.read_bytes())
    # Of the statistics in the footer: what Parquet itself does not notice.
    content[content.rindex(f"v1/{TASKS[0]}/{SPLIT}/1".encode())] ^= 1
    path.write_bytes(content)
    source = RenderConfig(recipe=recipe, out=tmp_path / "set")
    with pytest.raises(DatasetError, match="another checksum"):
        write_dataset(LeRobotConfig(source=source, style=STYLE), Serial())
    assert not (tmp_path / "set").exists()


def test_styles_that_cannot_be() -> None:
    for wrong in (
        {"fps": 30},
        {"width_px": 97},
        {"height_px": 30},
        {"video_file_s": 2000},
    ):
        with pytest.raises(InvalidConfigError):
            Style(**wrong)  # type: ignore[arg-type]
    with pytest.raises(UnknownNameError):
        Style(instruction="poem")


def test_held_out_sentences_are_no_task_of_training(tmp_path: Path) -> None:
    recipe, out = tmp_path / "recipe", tmp_path / "set"
    generate(
        GenerateConfig(out=recipe, tasks=TASKS[:1], splits=("train",), episodes=1),
        Serial(),
    )
    source = RenderConfig(recipe=recipe, out=out)
    with pytest.raises(DatasetError, match="held out"):
        write_dataset(
            LeRobotConfig(source=source, style=Style(instruction="unseen")), Serial()
        )
    assert not out.exists()


def test_an_encoder_that_is_missing_is_an_error() -> None:
    RGB.check()
    for wrong in ({"encoder": "no_such_encoder"}, {"pixels": "gray14le"}):
        with pytest.raises(DatasetError, match="cannot write"):
            replace(RGB, **wrong).check()  # type: ignore[arg-type]


def test_episodes_are_allotted_to_files() -> None:
    sizes = [(40, 5), (40, 5), (40, 5), (300, 5), (10, 5), (10, 90), (10, 5)]
    assert allot(sizes, 100) == [
        (0, 0),
        (0, 5),
        (1, 0),
        (2, 0),
        (3, 0),
        (3, 5),
        (3, 95),
    ]
    files = [file for file, _ in allot(sizes, 1000, most_frames=12)]
    assert files == [0, 0, 1, 1, 2, 3, 4]


def test_no_time_in_a_video_is_lost_in_float32() -> None:
    # What readers compare: the sum of two times, and the time of a frame.
    for begin in (0.0, 511.9, 999.0):
        for index in range(10):
            time_s = np.float32(begin + float(np.float32(index / 10)))
            assert abs(time_s - np.float32(begin + index / 10)) < 1e-4
    assert np.spacing(np.float32(Style().video_file_s)) < 1e-4


def test_depth_is_kept_to_the_millimetre() -> None:
    depth_m = np.array([[0.0, 0.5974, 3.4080, 99.0]], np.float32)
    assert levels_from_depth(depth_m).tolist() == [[0, 597, 3408, 4095]]
    assert pytest.approx(4.095) == DEPTH_LARGEST_M


def test_videos_are_joined_without_a_seam(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    lossless: Encoding = replace(RGB, crf=0, pixels="yuv444p", group=3)
    pictures = random.integers(0, 256, (11, 32, 48, 3), np.uint8)
    parts = []
    for number, some in enumerate((pictures[:4], pictures[4:5], pictures[5:])):
        film = Film(lossless, 48, 32, 10)
        for picture in some:
            film.add(picture)
        parts.append(tmp_path / f"{number}.mp4")
        parts[-1].write_bytes(film.finish())
    join(parts, 10, tmp_path / "all.mp4")
    found = decode_at(tmp_path / "all.mp4", [i / 10 for i in range(11)], "rgb24")
    for ours, theirs in zip(pictures, found, strict=True):
        assert psnr_db(ours, theirs) > 40
    parts[1].write_bytes(b"no video")
    with pytest.raises(DatasetError, match="cannot be read"):
        join(parts, 10, tmp_path / "again.mp4")


def shaded(frames: int) -> np.ndarray:
    """Return pictures with slopes and grain, (frames, 96, 128, 3) uint8."""
    time, y, x = np.mgrid[:frames, :96, :128]
    grain = np.random.default_rng(3).normal(0.0, 4.0, (frames, 96, 128, 3))
    slopes = 127 + 100 * np.sin(x / 17 + time / 5) * np.cos(y / 11)
    return np.clip(slopes[..., None] + grain, 0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    ("encoding", "option", "plain"),
    [(RGB, "x264-params", "no-asm=1"), (DEPTH, "x265-params", "asm=0")],
    ids=["rgb", "depth"],
)
def test_no_processor_writes_other_bytes(
    encoding: Encoding, option: str, plain: str
) -> None:
    pictures = shaded(12)
    if encoding is DEPTH:
        pictures = pictures[..., 0].astype(np.uint16) * 16
    found = []
    for suffix in ("", f":{plain}"):
        options = {**encoding.options, option: encoding.options[option] + suffix}
        film = Film(replace(encoding, options=options), 128, 96, 10)
        for picture in pictures:
            film.add(picture)
        found.append(film.finish())
    assert found[0] == found[1]


def test_the_encoder_took_its_options() -> None:
    film = Film(RGB, 128, 96, 10)
    for picture in shaded(2):
        film.add(picture)
    # As it says itself, in the video. Macroblock trees are not reproducible.
    told = film.finish()
    for word in (b"mbtree=0", b" threads=1 ", b"bframes=0", b"keyint=5 ", b"crf=27"):
        assert word in told


def test_figures_of_a_column() -> None:
    values = np.random.default_rng(1).normal(size=(50, 3))
    figures = describe(values)
    assert figures["q01"] == pytest.approx(np.quantile(values, 0.01, axis=0))
    assert figures["count"] == [50]
    total = Total()
    for some in (values[:1], values[1:20], values[20:]):
        total.add(describe(some))
    whole = total.figures()
    for figure in ("min", "max", "mean", "std", "count"):
        assert whole[figure] == pytest.approx(figures[figure])
    assert describe([True, False, False])["mean"] == pytest.approx([1 / 3])


def test_a_histogram_knows_all_figures() -> None:
    random = np.random.default_rng(2)
    pictures = random.integers(0, 9, (5, 8, 6, 3)) * np.array([1, 2, 3])
    histogram = Histogram(3, 256)
    for picture in pictures:
        histogram.add(picture.astype(np.uint8))
    pixels = pictures[:, ::2, ::2].reshape(-1, 3) / 255
    found = histogram.describe(1 / 255)
    expected = describe(pixels)
    assert found.pop("count") == [5]
    for name, figures in found.items():
        assert np.ravel(figures) == pytest.approx(expected[name])
