"""Files of weights, with the name and options of their model and their provenance.

Weights are safetensors in 16 bits with JSON metadata. Published files are packed in
about seven bits per weight: large matrices and kernels are quantised to whole multiples
of a step, which are stored with a Huffman code (``scripts/publish_weights.py`` packs
them). Files are not trusted: nothing in them is executed, and sizes are checked before
memory is allocated.
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
from lemma.policies.batch import check_gpu
from lemma.policies.class_path import LEROBOT
from lemma.policies.models.base import Model
from lemma.policies.models.catalog import MODELS, make_model

METADATA_KEY = "lemma"
WEIGHTS_VERSION = "2"
TIME_LIMIT: Literal["time limit"] = "time limit"
"""End of a run whose number of steps depends on the machine."""
LARGEST_MULTIPLE = 2**15 - 1
"""Largest multiple of its step that a packed weight may be."""
_LARGEST_STEP = float(np.finfo(np.float32).max) / (LARGEST_MULTIPLE + 1)
"""Largest step; values of a larger one would overflow float32."""
_LONGEST = 2**20
"""Largest number of characters of metadata."""


@dataclass(frozen=True)
class Rounding:
    """Quantisation of one tensor."""

    shape: tuple[int, ...]
    step: float
    """Value of the whole number 1."""


@dataclass(frozen=True)
class WeightsMetadata:
    """Metadata of a file of weights."""

    model: str
    """Name of the model, as in ``lemma train``."""
    options: dict[str, Any]
    """Options of the model."""
    data: dict[str, Any] = field(default_factory=dict)
    """Version and digest of the data that it was trained on."""
    command: str = ""
    """The command line that made it."""
    scores: dict[str, float | None] = field(default_factory=dict)
    """Validation scores by name."""
    training: dict[str, Any] = field(default_factory=dict)
    """All options of the run."""
    ended: Literal["", "steps", "time limit"] = ""
    """Why the run ended: all steps were done, or the time limit was reached, so that
    the number of steps depends on the machine. Empty during the run, or if unknown."""
    steps: int | None = None
    """Number of steps at the end of the run."""
    packed: dict[str, Rounding] = field(default_factory=dict)
    """Quantisation of the packed tensors, by name; the others are in 16 bits."""
    lemma: str = ""
    """Version of the package."""
    version: str = WEIGHTS_VERSION
    """Version of the format."""


def write_weights(
    path: Path, weights: Mapping[str, Tensor], metadata: WeightsMetadata
) -> None:
    """Write weights in 16 bits, atomically.

    Args:
        path: The file.
        weights: A module's ``state_dict``.
        metadata: Metadata to write into it.

    Raises:
        WeightsError: A value is not finite in 16 bits.
        DatasetError: The disk is full, or the folder cannot be written to.
    """
    write_tensors(path, in_16_bits(weights), metadata)


def in_16_bits(weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return copies of weights on the CPU, floating-point ones in 16 bits.

    Raises:
        WeightsError: A value is not finite in 16 bits.
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
    """Write the end of the training run into the file of its best weights.

    Args:
        path: The file.
        ended: Reason why it ended.
        steps: Number of steps done.

    Raises:
        WeightsError: The file is missing or damaged.
        DatasetError: The disk is full, or the folder cannot be written to.
    """
    metadata = replace(read_metadata(path), ended=ended, steps=steps)
    with safe_open(path, "pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    write_tensors(path, tensors, metadata)


def write_tensors(
    path: Path, tensors: dict[str, Tensor], metadata: WeightsMetadata
) -> None:
    """Write tensors without conversion, atomically.

    Args:
        path: The file.
        tensors: Tensors on the CPU, by name.
        metadata: Metadata to write into it.

    Raises:
        DatasetError: The disk is full, or the folder cannot be written to.
    """
    text = msgspec.json.encode(metadata, order="sorted").decode()

    def write(draft: Path) -> None:
        save_file(tensors, draft, {METADATA_KEY: text})
        # By default only the owner may read the file.
        draft.chmod(0o644)

    write_whole(path, write)


def read_metadata(path: Path) -> WeightsMetadata:
    """Return the metadata of a file of weights.

    Raises:
        WeightsError: The file is missing, damaged, or has no metadata of weights.
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
    """Return the model in a file of weights, in evaluation mode.

    Args:
        path: The file.
        device: Device of the model.

    Raises:
        InvalidConfigError: There is no GPU, and the device is one.
        WeightsError: The file is missing, damaged, or does not fit its model.
    """
    if torch.device(device).type == "cuda":
        check_gpu()
    metadata = read_metadata(path)
    if metadata.model.startswith(LEROBOT):
        raise WeightsError(
            f"{path} holds a LeRobot checkpoint, which returns motor commands. Put "
            f"{LEROBOT!r} before its name."
        )
    try:
        kind = MODELS[metadata.model][0]
        former = kind.former_names
        options = _completed(metadata.options, kind.former_options)
        with safe_open(path, "pt") as file:
            found = {_renamed(name, former): name for name in file.keys()}  # noqa: SIM118
            # Check shapes on "meta" first: valid options may need much memory.
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
        # torch raises RuntimeError for impossible sizes.
        raise _damaged(path, error) from error
    return model.to(device).eval()


class _Unfilled(TorchFunctionMode):
    """Skips the initialisation of weights, which a file then overwrites.

    Initialisation takes time; on the device "meta" torch would even load its compiler,
    which takes a second.
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
    """Return the present name of a tensor with a former name."""
    for pattern, now in former.items():
        name = re.sub(pattern, now, name)
    return name


def _completed(given: Mapping[str, Any], former: Mapping[str, Any]) -> dict[str, Any]:
    """Return options with those that they lack, also in parts of the model."""
    options = {**former, **given}
    for part, values in former.items():
        if isinstance(values, Mapping):
            options[part] = _completed(given.get(part, {}), values)
    return options


def _check_shapes(
    path: Path,
    metadata: WeightsMetadata,
    file: Any,
    names: Mapping[str, str],
    wanted: Mapping[str, Tensor],
) -> None:
    """Check that a file has the tensors of a model, before reading them.

    Args:
        path: Path of the file.
        metadata: Metadata of the file.
        file: The opened file.
        names: Names of tensors in the file, by their present names.
        wanted: Tensors of the model.

    Raises:
        WeightsError: Names or shapes differ from those of the model.
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
    """Return a tensor of a file, with the type of the model's tensor.

    Raises:
        ValueError: Its type does not match, or it is not finite.
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

    Its memory is bounded by the shape, even for damaged codes.

    Args:
        coded: Code, (bytes,) uint8.
        rounding: Quantisation of the tensor.

    Raises:
        ValueError: The code is damaged, or does not have as many values as the shape.
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
        # The second stream begins behind the end of the first.
        coded = decoder.unconsumed_tail or decoder.unused_data
    folded = planes[0] | (planes[1] << 8)
    numbers: NDArray[np.int32] = (folded >> 1) ^ -(folded & 1)
    return numbers


def _damaged(path: Path, error: Exception) -> WeightsError:
    return WeightsError(
        f"{path} is damaged, or no file of weights: {error}. Fetch it again, or train "
        "again."
    )
