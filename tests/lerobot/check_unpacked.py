"""Unpacked samples are those of lerobot, and groups become one data set."""

import re
import sys
from importlib import import_module
from pathlib import Path
from shutil import copytree
from tempfile import mkdtemp
from typing import Any

import pytest
import torch
from check_training import CHUNK, STEPS, export, run, small_act

from lemma.core.errors import DatasetError
from lemma.core.workers.pool import Serial
from lemma.dataset.lerobot.aggregate import aggregate_in_groups
from lerobot_train_unpacked import unpack, unpacked

SCRIPT = Path(__file__).parents[2] / "scripts/lerobot_train_unpacked.py"
CAMERAS = [f"observation.images.robot_{robot}" for robot in range(2)]
CHUNKS = {"action": [step / 10 for step in range(CHUNK)]}
HISTORIES = {name: [-0.1, 0.0] for name in ("observation.state", *CAMERAS)}
COPIES = 6


def read(root: Path, **options: Any) -> Any:
    module = import_module("lerobot.datasets.lerobot_dataset")
    return module.LeRobotDataset("lemma/x", root=root, video_backend="pyav", **options)


@pytest.fixture(scope="module")
def pictures() -> Path:
    folder = Path(mkdtemp(prefix="lemma-unpacked-"))
    assert unpack(export(), folder, Serial()) == len(list(export().rglob("*.mp4")))
    return folder


@pytest.mark.parametrize(
    "deltas", [None, CHUNKS, HISTORIES | CHUNKS], ids=["one", "chunk", "history"]
)
def test_every_kind_of_sample_is_the_same(
    deltas: Any, pictures: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """ACT reads chunks of actions, Diffusion Policy a history of pictures too."""
    options = {"delta_timestamps": deltas, "return_uint8": True}
    wanted = read(export(), **options)
    module = import_module("lerobot.datasets.lerobot_dataset")
    kind = unpacked(module.DatasetReader, pictures)
    monkeypatch.setattr(module, "DatasetReader", kind)
    found = read(export(), **options)
    ends = [row["dataset_to_index"] for row in wanted.meta.episodes]
    for index in (0, 1, 50, *(end + step for end in ends for step in (-2, -1))):
        same(found[index], wanted[index])


def same(one: dict[str, Any], other: dict[str, Any]) -> None:
    assert one.keys() == other.keys()
    for name, value in other.items():
        if isinstance(value, torch.Tensor):
            assert one[name].dtype == value.dtype, name
            assert torch.equal(one[name], value), name
        else:
            assert one[name] == value, name


def test_where_no_data_set_is_nothing_is_unpacked(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="There is no LeRobotDataset"):
        unpack(tmp_path, tmp_path / "pictures", Serial())


def test_what_is_not_unpacked_is_refused(
    pictures: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = import_module("lerobot.datasets.lerobot_dataset")
    kind = unpacked(module.DatasetReader, pictures)
    monkeypatch.setattr(module, "DatasetReader", kind)
    with pytest.raises(DatasetError, match="supports only whole data sets"):
        read(export(), episodes=[0], return_uint8=True)
    with pytest.raises(DatasetError, match="Only lerobot-train"):
        read(export())


def test_lerobot_trains_on_it_and_learns_the_same(pictures: Path) -> None:
    options = small_act("trained-unpacked", loaders=1)
    python = Path(sys.executable).name
    told = run(python, str(SCRIPT), "train", str(pictures), *options)
    assert losses(told) == losses(run("lerobot-train", *small_act("trained-again")))


def losses(told: str) -> list[str]:
    found = re.findall(r"\sloss:(\S+)", told)
    assert len(found) == STEPS
    return found


def test_pictures_of_another_export_are_not_taken_for_them(
    tmp_path: Path, pictures: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second export into the same folder has other videos of the same names."""
    root = tmp_path / "set"
    copytree(export(), root)
    first, second = sorted((root / "videos" / CAMERAS[0]).rglob("*.mp4"))[:2]
    first.write_bytes(second.read_bytes() + bytes(1))
    module = import_module("lerobot.datasets.lerobot_dataset")
    kind = unpacked(module.DatasetReader, pictures)
    monkeypatch.setattr(module, "DatasetReader", kind)
    with pytest.raises(DatasetError, match="is not unpacked"):
        read(root, return_uint8=True)


def test_groups_are_aggregated_in_order(tmp_path: Path) -> None:
    copies = [tmp_path / f"{number:06d}" for number in range(COPIES)]
    for copy in copies:
        copy.symlink_to(export())
    aggregate_in_groups(copies, tmp_path / "whole", Serial())
    assert len([*tmp_path.glob("*.group")]) > 1
    one, whole = read(export()), read(tmp_path / "whole")
    assert len(whole) == COPIES * len(one)
    own = ("index", "episode_index")
    for index in (0, len(one) - 1):
        wanted = one[index]
        for number in (0, COPIES - 1):
            found = whole[number * len(one) + index]
            assert int(found["index"]) == number * len(one) + index
            same(
                *(
                    {k: v for k, v in it.items() if k not in own}
                    for it in (found, wanted)
                )
            )
