"""Files of weights: which model they belong to, its options, and where they come from.

Weights are safetensors in 16 bits; metadata are JSON beside them. Published files are
packed in about seven bits a weight: large matrices and kernels are whole multiples of a
step, and these are stored with a Huffman code (``scripts/publish_weights.py`` packs). A
file may come from anybody: nothing in it is executed, and all of it is checked before
memory is taken for it.
"""

import math
import re
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor
from torch.overrides import TorchFunctionMode

from lemma.core.errors import LemmaError, WeightsError
from lemma.core.files import write_whole
from lemma.policies.class_path import LEROBOT
from lemma.policies.models.base import Model
from lemma.policies.models.catalog import MODELS, make_model

METADATA_KEY = "lemma"
WEIGHTS_VERSION = "2"
TIME_LIMIT: Literal["time limit"] = "time limit"
"""How a run ended that other machines would have ended elsewhere."""
LARGEST_MULTIPLE = 2**15 - 1
"""Largest multiple of its step that a packed weight may be."""
_LARGEST_STEP = float(np.finfo(np.float32).max) / (LARGEST_MULTIPLE + 1)
"""Values of larger ones would overflow."""
_LONGEST = 2**20
"""Characters of metadata that are read."""


@dataclass(frozen=True)
class Rounding:
    """How one tensor was rounded."""

    shape: tuple[int, ...]
    step: float
    """Value of the whole number 1."""


@dataclass(frozen=True)
class WeightsMetadata:
    """Metadata of a file of weights."""

    model: str
    """Its name, as ``lemma train`` knows it."""
    options: dict[str, Any]
    """Options of the model."""
    data: dict[str, Any] = field(default_factory=dict)
    """Version and digest of the data that it was trained on."""
    command: str = ""
    """The command line that made it."""
    scores: dict[str, float | None] = field(default_factory=dict)
    """In validation."""
    training: dict[str, Any] = field(default_factory=dict)
    """All options of the run."""
    ended: Literal["", "steps", "time limit"] = ""
    """Why the run ended: all steps were done, or a time limit, after which other
    machines have done other steps. Empty while it goes on, or if it is unknown."""
    steps: int | None = None
    """Steps that were done when it ended."""
    packed: dict[str, Rounding] = field(default_factory=dict)
    """How the tensors were rounded that are not in 16 bits, by name."""
    lemma: str = ""
    """Version of the package."""
    version: str = WEIGHTS_VERSION
    """Version of the format."""


def write_weights(
    path: Path, weights: Mapping[str, Tensor], metadata: WeightsMetadata
) -> None:
    """Write weights in 16 bits, whole or not at all.

    Args:
        path: The file.
        weights: By name, as a module's ``state_dict`` has them.
        metadata: Metadata to write into it.

    Raises:
        WeightsError: One does not fit into 16 bits.
        DatasetError: The disk is full, or the folder cannot be written to.
    """
    write_tensors(path, in_16_bits(weights), metadata)


def in_16_bits(weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return copies in memory of weights, those with a fraction in 16 bits.

    Raises:
        WeightsError: One does not fit into 16 bits.
    """
    tensors = {}
    for name, value in weights.items():
        tensors[name] = value.detach().to("cpu", copy=True).contiguous()
        if value.is_floating_point():
            tensors[name] = tensors[name].half()
            if not torch.isfinite(tensors[name]).all():
                raise WeightsError(
                    f"Weight {name!r} is not finite in 16 bits. Training diverged; "
                    "lower the learning rate."
                )
    return tensors


def mark_ended(path: Path, ended: Literal["steps", "time limit"], steps: int) -> None:
    """Write into a file of weights how the run ended that they are the best of.

    Args:
        path: The file.
        ended: Reason why it ended.
        steps: Number of steps done.

    Raises:
        WeightsError: It is missing or damaged.
        DatasetError: The disk is full, or the folder cannot be written to.
    """
    metadata = replace(read_metadata(path), ended=ended, steps=steps)
    with safe_open(path, "pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    write_tensors(path, tensors, metadata)


def write_tensors(
    path: Path, tensors: dict[str, Tensor], metadata: WeightsMetadata
) -> None:
    """Write tensors as they are, whole or not at all.

    Args:
        path: The file.
        tensors: By name, in memory.
        metadata: Metadata to write into it.

    Raises:
        DatasetError: The disk is full, or the folder cannot be written to.
    """
    text = msgspec.json.encode(metadata, order="sorted").decode()

    def write(draft: Path) -> None:
        save_file(tensors, draft, {METADATA_KEY: text})
        # Without it only the owner may read them.
        draft.chmod(0o644)

    write_whole(path, write)


def read_metadata(path: Path) -> WeightsMetadata:
    """Return what a file of weights says about itself.

    Raises:
        WeightsError: It is missing, damaged, or no such file.
    """
    try:
        with safe_open(path, "pt") as file:
            text = (file.metadata() or {}).get(METADATA_KEY)
    except FileNotFoundError as error:
        raise WeightsError(
            f"There is no file {path}. Write the path of weights."
        ) from error
    except (SafetensorError, OSError, ValueError) as error:
        raise _damaged(path, error) from error
    if text is None:
        raise WeightsError(
            f"{path} does not say which model it is for. Only files that 'lemma "
            "train' wrote can be loaded."
        )
    if len(text) > _LONGEST:
        raise _damaged(path, ValueError(f"its metadata have {len(text)} characters"))
    try:
        metadata = msgspec.json.decode(text, type=WeightsMetadata)
    except (msgspec.MsgspecError, RecursionError) as error:
        raise WeightsError(
            f"{path} was written by another version of this package, or is damaged: "
            f"{error}. Fetch it again, or train again."
        ) from error
    if metadata.version != WEIGHTS_VERSION:
        raise WeightsError(
            f"{path} has version {metadata.version} of the format of weights, and this "
            f"package reads version {WEIGHTS_VERSION}. Install lemma-bench "
            f"{metadata.lemma}, or train again."
        )
    return metadata


def load_weights(path: Path, device: torch.device | str = "cpu") -> Model:
    """Return the model in a file of weights, ready to be used.

    Args:
        path: The file.
        device: Where it shall be.

    Raises:
        WeightsError: The file is missing, damaged, or does not fit its model.
    """
    metadata = read_metadata(path)
    if metadata.model.startswith(LEROBOT):
        raise WeightsError(
            f"{path} holds a checkpoint of LeRobot, which commands motors. Put "
            f"{LEROBOT!r} before its name."
        )
    try:
        kind = MODELS[metadata.model][0]
        former, options = kind.former_names, dict(metadata.options)
        for part, values in kind.former_options.items():
            options[part] = {**values, **options.get(part, {})}
        with safe_open(path, "pt") as file:
            found = {_renamed(name, former): name for name in file.keys()}  # noqa: SIM118
            # First a model that takes no memory: sizes in their ranges may be large.
            with torch.device("meta"), _Unfilled():
                wanted = make_model(metadata.model, options).state_dict()
            _check_shapes(path, metadata, file, found, wanted)
            with _Unfilled():
                model = make_model(metadata.model, options)
            model.load_state_dict(
                {
                    name: _read_tensor(file, found[name], metadata, value)
                    for name, value in wanted.items()
                }
            )
    except WeightsError:
        raise
    except LemmaError as error:
        raise WeightsError(
            f"{path} is for a model of another version of this package "
            f"({metadata.lemma or 'unknown'}): {error} Install that version, or train "
            f"again: {metadata.command or 'lemma train'}"
        ) from error
    except (SafetensorError, OSError, KeyError, ValueError, RuntimeError) as error:
        # torch has RuntimeErrors for sizes that cannot be.
        raise _damaged(path, error) from error
    return model.to(device).eval()


class _Unfilled(TorchFunctionMode):
    """Leaves out the numbers that new weights begin with: those of a file follow.

    Drawing them takes time, and on the device "meta", which has none to draw, torch
    would load its compiler for it: a second.
    """

    def __torch_function__(
        self,
        func: Callable[..., Any],
        types: Any,
        args: tuple[Any, ...] = (),
        kwargs: dict[str, Any] | None = None,
    ) -> Any:
        """Call a function of torch, unless it fills a tensor."""
        keywords = kwargs or {}
        if getattr(func, "__module__", "") == "torch.nn.init":
            return keywords["tensor"] if "tensor" in keywords else args[0]
        return func(*args, **keywords)


def _renamed(name: str, former: Mapping[str, str]) -> str:
    """Return the present name of weights."""
    for pattern, now in former.items():
        name = re.sub(pattern, now, name)
    return name


def _check_shapes(
    path: Path,
    metadata: WeightsMetadata,
    file: Any,
    names: Mapping[str, str],
    wanted: Mapping[str, Tensor],
) -> None:
    """Check that a file has the tensors of a model, before any is read.

    Args:
        path: Path of the file.
        metadata: Metadata of the file.
        file: The opened file.
        names: Names of tensors in the file, by their present names.
        wanted: Tensors that the model has.

    Raises:
        WeightsError: They are of another model, or of other options.
    """
    found = {
        now: metadata.packed[name].shape
        if name in metadata.packed
        else tuple(file.get_slice(name).get_shape())
        for now, name in names.items()
    }
    problems = [f"{name} is missing" for name in wanted if name not in found]
    problems += [f"{name} is not known" for name in found if name not in wanted]
    problems += [
        f"{name} is {found[name]} instead of {tuple(value.shape)}"
        for name, value in wanted.items()
        if name in found and found[name] != tuple(value.shape)
    ]
    if problems:
        more = f" and {len(problems) - 3} more" if len(problems) > 3 else ""
        raise WeightsError(
            f"{path} does not fit {metadata.model} of this version: "
            f"{'; '.join(problems[:3])}{more}. Use weights that were trained with this "
            "version and the same options, or train again."
        )


def _read_tensor(
    file: Any, name: str, metadata: WeightsMetadata, like: Tensor
) -> Tensor:
    """Return a tensor of a file, of the type that a model's own has.

    Raises:
        ValueError: It is of another type, or not finite.
    """
    value: Tensor = file.get_tensor(name)
    if name in metadata.packed:
        try:
            value = unpack(value, metadata.packed[name])
        except ValueError as error:
            raise ValueError(f"{name} has {error}") from error
    if value.is_floating_point() != like.is_floating_point():
        raise ValueError(f"{name} is {value.dtype} where {like.dtype} is meant")
    if value.is_floating_point() and not torch.isfinite(value).all():
        raise ValueError(f"{name} is not finite")
    return value.to(like.dtype)


def unpack(coded: Tensor, rounding: Rounding) -> Tensor:
    """Return the values of a packed tensor, float32.

    It takes no more memory than the shape needs, even for damaged codes.

    Args:
        coded: (bytes,) uint8.
        rounding: How it was rounded.

    Raises:
        ValueError: The code is not that of such a tensor.
    """
    if not 0.0 < rounding.step < _LARGEST_STEP:
        raise ValueError(f"a step of {rounding.step}")
    if coded.dtype != torch.uint8 or coded.ndim != 1:
        raise ValueError(f"{coded.dtype} of shape {tuple(coded.shape)} is no code")
    numbers = _decoded(coded.numpy().tobytes(), math.prod(rounding.shape))
    values = torch.from_numpy(numbers.astype(np.float32) * np.float32(rounding.step))
    return values.view(rounding.shape)


def _decoded(coded: bytes, count: int) -> NDArray[np.int32]:
    planes = []
    for _ in range(2):
        decoder = zlib.decompressobj()
        try:
            found = decoder.decompress(coded, count + 1)
        except zlib.error as error:
            raise ValueError(str(error)) from error
        if len(found) != count:
            raise ValueError(f"{len(found)} values or more instead of {count}")
        planes.append(np.frombuffer(found, np.uint8).astype(np.int32))
        # Empty where the code is cut off, or goes on behind its end.
        coded = decoder.unconsumed_tail or decoder.unused_data
    folded = planes[0] | (planes[1] << 8)
    numbers: NDArray[np.int32] = (folded >> 1) ^ -(folded & 1)
    return numbers


def _damaged(path: Path, error: Exception) -> WeightsError:
    return WeightsError(
        f"{path} is damaged, or no file of weights: {error}. Fetch it again, or train "
        "again."
    )
