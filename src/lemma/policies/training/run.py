"""Preparation of a training run: data, initial weights, folder, and its report."""

import hashlib
import json
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch

from lemma.core.errors import DatasetError, InvalidConfigError
from lemma.core.files import read_json, write_json
from lemma.core.seeding import stream
from lemma.core.version import VERSION as __version__
from lemma.core.workers.resumable import check_same_job
from lemma.dataset.files import MANIFEST, read_manifest
from lemma.dataset.recipe.schema import executions, perturbed_as
from lemma.dataset.rendered.dataset import keyframe_shards
from lemma.dataset.rendered.keyframes import FORM
from lemma.policies.entities import BENCHMARK, EntitySet
from lemma.policies.frames import Frames
from lemma.policies.models.base import Model
from lemma.policies.models.catalog import MODELS, make_model, options_of
from lemma.policies.training.config import MAY_CHANGE, TrainingConfig, model_options
from lemma.policies.training.distributed import ProcessGroup
from lemma.policies.training.step import Scores, seed_of, units_of
from lemma.policies.weights import load_model
from lemma.tasks.instance import BENCHMARK_VERSION

CONFIG = "config.json"
CHECKPOINT = "checkpoint.pt"
WEIGHTS = "weights.safetensors"
REPORT = "report.json"

_BYTES_PER_CELL = 5


@dataclass(frozen=True)
class Data:
    """Training data, and validation data for the selection of the best weights."""

    train: Frames
    val: Frames
    about: dict[str, Any]
    """Version and digest."""
    recovery: Frames | None = None
    """Recovery states of the training instances."""


def check_data(
    folder: Path, splits: Collection[str], *, recovery: bool = False
) -> dict[str, Any]:
    """Return version and digests of rendered keyframes; see :func:`digests_of`.

    The digest covers everything that determines their bits: the episodes of the recipe,
    the form, the software and the renderer.

    Args:
        folder: Folder of the keyframes.
        splits: The splits that are read.
        recovery: Whether to expect recovery states instead of demonstrations.

    Raises:
        DatasetError: The folder is missing, of another version, or does not have the
            expected kind of data.
    """
    if not folder.is_dir():
        raise DatasetError(
            f"There is no folder {folder}. Make one from a recipe: lemma render RECIPE "
            f"--out {folder} --form {FORM}"
        )
    files = read_manifest(folder, FORM)
    about = read_json(folder / MANIFEST).get("about", {})
    found = about.get("versions", {})
    if found.get("benchmark") != BENCHMARK_VERSION:
        raise DatasetError(
            f"{folder} was made from version {found.get('benchmark')} of the "
            f"benchmark, and this package has {BENCHMARK_VERSION}. Train with lemma-"
            f"bench {found.get('lemma')}, or make the data again."
        )
    if recovery and not perturbed_as(found):
        raise DatasetError(
            f"{folder} holds {executions(found)}, but --recovery takes perturbed "
            "executions: lemma generate --perturb 0.3, then lemma render --form "
            f"{FORM}. Demonstrations are named by --data."
        )
    if perturbed_as(found) and not recovery:
        raise DatasetError(
            f"{folder} holds {executions(found)}. They are mixed in with --recovery; "
            "--data takes demonstrations, which select the best weights."
        )
    # Not the files' checksums: the files contain the revision that rendered them.
    decisive = {name: found[name] for name in found if name != "revision"}
    content = {
        name: entry.get("content_sha256", entry["sha256"])
        for name, entry in files.items()
    }
    renderer = about.get("renderer", "")
    digests = digests_of({**about, "versions": decisive}, content, splits)
    return {"benchmark": BENCHMARK_VERSION, **digests, "renderer": renderer}


def digests_of(
    about: dict[str, Any], content: dict[str, str], splits: Collection[str]
) -> dict[str, str]:
    """Return the digest of rendered keyframes, and one by which seeds are compared.

    The second one leaves out the renderer, and the files of splits that are not read.

    Args:
        about: Form, versions and renderer.
        content: For each file, ``maps/train/pass-000.arrow``, the digest of its
            episodes.
        splits: The splits that are read.
    """

    def digest(settings: dict[str, Any], files: dict[str, str]) -> str:
        hashed = {"about": settings, "content": files}
        return hashlib.sha256(json.dumps(hashed, sort_keys=True).encode()).hexdigest()

    rest = {name: value for name, value in about.items() if name != "renderer"}
    read = {name: content[name] for name in content if Path(name).parts[1] in splits}
    return {"digest": digest(about, content), "of_any_renderer": digest(rest, read)}


def read_frames(
    config: TrainingConfig,
    team: ProcessGroup,
    entities: EntitySet = BENCHMARK,
    *,
    mixed: bool = False,
) -> Data:
    """Read both splits, to the device if they fit.

    Args:
        config: Options of the training run.
        team: The process group.
        entities: Entities of the model.
        mixed: Whether the model learns from teams of different sizes.

    Raises:
        DatasetError: Files are missing, damaged or of another version.
        UnknownNameError: There is no such split or task.
    """
    splits = {config.train_split, config.val_split}
    about = check_data(config.data, splits)
    tasks = config.tasks
    sources = [(config.data, config.train_split), (config.data, config.val_split)]
    if config.recovery is not None:
        found = check_data(config.recovery, splits, recovery=True)
        about["recovery"] = found["digest"]
        sources.append((config.recovery, config.train_split))
    size = sum(
        sum(shard.header.keyframes)
        * (shard.header.raster.rows * shard.header.raster.columns * _BYTES_PER_CELL)
        for folder, split in sources
        for shard in keyframe_shards(folder, split, tasks)
    )
    how = tasks, _place(config, team.device, size), entities
    read = partial(Frames.load, shared=config.shared_images, mixed=mixed)
    train = read(config.data, config.train_split, *how)
    same = config.val_split == config.train_split
    val = train if same else read(config.data, config.val_split, *how)
    recovery = None
    if config.recovery is not None:
        recovery = read(config.recovery, config.train_split, *how)
        ours, theirs = ((each.raster, each.robots) for each in (train, recovery))
        if ours != theirs:
            raise DatasetError(
                f"Recovery states have {theirs[1]} robots and maps of {theirs[0]}, but "
                f"the data have {ours[1]} and {ours[0]}. Render both with the same "
                "version."
            )
    return Data(train, val, about, recovery)


def _place(config: TrainingConfig, device: torch.device, size: int) -> torch.device:
    if device.type == "cpu" or config.images == "host":
        return torch.device("cpu")
    # Loading from the host is nearly as fast, and leaves device memory free.
    enough = size < torch.cuda.mem_get_info(device)[0] / 10
    return device if enough or config.images == "device" else torch.device("cpu")


def recovery_units(
    model: Model, recovery: Frames, units: Sequence[Sequence[int]], train: Frames
) -> list[Sequence[int]]:
    """Return the frames of each unit of recovery states to mix in.

    Args:
        model: Model, which determines the units.
        recovery: Recovery states.
        units: Units of the training set; states of other instances are left out.
        train: Frames of the training set.

    Raises:
        DatasetError: No recovery state is of a training instance.
    """
    known = {train.instances[frame] for unit in units for frame in unit}
    found: list[Sequence[int]] = [
        episode
        for episode in recovery.episodes
        if recovery.instances[episode[0]] in known
    ]
    if not found:
        raise DatasetError(
            "No recovery state is of a training instance. Perturb the same tasks, "
            "splits and episodes."
        )
    return units_of(model, found)


def training_units(
    model: Model, frames: Frames, config: TrainingConfig
) -> list[Sequence[int]]:
    """Return the frames of each unit to train on.

    Raises:
        InvalidConfigError: The split has fewer episodes than the options select.
    """
    episodes: list[Sequence[int]] = list(frames.episodes)
    if config.episodes_per_task is not None:
        episodes = _first_of_each_task(frames, config.episodes_per_task)
    if config.episodes is not None:
        if config.episodes > len(episodes):
            raise InvalidConfigError(
                f"--episodes is {config.episodes}, but split {config.train_split!r} "
                f"has {len(episodes)}."
            )
        drawn = stream("episodes", config.seed).permutation(len(episodes))
        episodes = [episodes[i] for i in sorted(drawn[: config.episodes].tolist())]
    return units_of(model, episodes)


def _first_of_each_task(frames: Frames, count: int) -> list[Sequence[int]]:
    """Return the first ``count`` episodes of each task.

    Raises:
        InvalidConfigError: A task has fewer episodes.
    """
    listed: dict[str, list[Sequence[int]]] = {}
    for episode in sorted(frames.episodes, key=lambda one: frames.instances[one[0]]):
        listed.setdefault(frames.tasks[episode[0]], []).append(episode)
    for task, found in listed.items():
        if len(found) < count:
            raise InvalidConfigError(
                f"--episodes-per-task is {count}, but there are {len(found)} of {task}."
            )
    chosen = [episode for found in listed.values() for episode in found[:count]]
    return sorted(chosen, key=lambda episode: episode[0])


def first_model(config: TrainingConfig) -> Model:
    """Return the model with its initial weights, a function of the seed.

    Raises:
        UnknownNameError: There is no such model or option.
        WeightsError: The initial weights are missing or damaged.
        InvalidConfigError: The initial weights are of another model.
    """
    kind, _ = MODELS[config.model]
    chosen = model_options(config.options)
    torch.manual_seed(seed_of(config.seed, -1))
    if config.start is None:
        return make_model(config.model, chosen)
    if chosen:
        raise InvalidConfigError(
            "--start takes the options of the model from its weights. Leave out "
            "--options."
        )
    model: Model = load_model(config.start)
    if type(model) is not kind:
        raise InvalidConfigError(
            f"{config.start} is a {type(model).__name__}, not {config.model}. Choose "
            "weights of the same model."
        )
    return model


def open_run(
    config: TrainingConfig, model: Model, data: dict[str, Any], command: str
) -> None:
    """Write the configuration of a run, or check that it has not changed.

    Args:
        config: Resolved options.
        model: Model, whose options are written, too.
        data: Version and digest of the data.
        command: The command line.

    Raises:
        DatasetError: Another run is in its folder.
    """
    path = config.out / CONFIG
    wanted = {
        "training": config.to_dict(),
        "model_options": json.loads(json.dumps(options_of(model))),
        "data": data,
    }
    if path.exists():
        found = read_json(path)
        check_same_job(
            config.out,
            {name: found.get(name, {}) for name in wanted},
            wanted,
            may_differ=[f"training.{name}" for name in MAY_CHANGE],
            advice="Choose another --out, or --restart to begin this one anew.",
        )
    write_json(path, {**wanted, "command": command, "lemma": __version__})


def clear_run(folder: Path) -> None:
    """Remove the files of a run."""
    for name in (CONFIG, CHECKPOINT, WEIGHTS, REPORT):
        (folder / name).unlink(missing_ok=True)
    for log in (folder / "tensorboard").glob("events.*"):
        log.unlink()


@dataclass(frozen=True)
class TrainingReport:
    """Summary of a run, written as ``report.json``."""

    status: str
    """``finished``, ``time is up`` or ``interrupted``."""
    model: str
    parameters: int
    """Number of trainable parameters."""
    steps: int
    samples: int
    """Number of drawn frames."""
    passes: float
    """Number of epochs over the demonstrations."""
    seconds: float
    """Seconds of training, summed over continued runs."""
    samples_per_s: float
    """Frames per second in this run, without validation and checkpoints."""
    input_wait: float
    """Share of that time in which the model waited for a batch, 0 to 1."""
    gpu_memory_gb: float
    """Peak memory of this run."""
    device: str
    scores: Scores
    """Validation scores of the best weights."""
    best_step: int
    scores_by_kind: dict[str, Scores]
    """Validation scores by kind of instruction, after the end of the run."""
    history: list[dict[str, float]]
    """All validations."""
    data: dict[str, Any]
    command: str
    lemma: str
    torch: str
