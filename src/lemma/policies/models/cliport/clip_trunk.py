"""The trunk of CLIP's ResNet, for those who have its weights.

CLIP's image encoder departs from the usual ResNet in three ways: three convolutions and
a pooling before the first stage, pooling instead of strides where resolution halves,
and attention instead of an average at the end, which is not needed here. It stays as it
was trained: no gradients, statistics of normalisation frozen.
"""

import re
import warnings
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.core.errors import InvalidConfigError

_MEAN = (0.48145466, 0.4578275, 0.40821073)
_DEVIATION = (0.26862954, 0.26130258, 0.27577711)
_STAGES = 4
_EXPANSION = 4
_PREFIX = "visual."


class _Bottleneck(nn.Module):
    """Narrow, look around, widen; an average halves the resolution."""

    def __init__(self, channels_in: int, width: int, halves: bool) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels_in, width, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.conv2 = nn.Conv2d(width, width, 3, padding=1, bias=False)
        self.bn2 = nn.BatchNorm2d(width)
        self.conv3 = nn.Conv2d(width, width * _EXPANSION, 1, bias=False)
        self.bn3 = nn.BatchNorm2d(width * _EXPANSION)
        self.halves = halves
        self.downsample: nn.ModuleDict | None = None
        if halves or channels_in != width * _EXPANSION:
            # The names are those of the published weights; number -1 pools.
            self.downsample = nn.ModuleDict(
                {
                    "0": nn.Conv2d(channels_in, width * _EXPANSION, 1, bias=False),
                    "1": nn.BatchNorm2d(width * _EXPANSION),
                }
            )

    def forward(self, x: Tensor) -> Tensor:
        y = F.relu(self.bn1(self.conv1(x)))
        y = F.relu(self.bn2(self.conv2(y)))
        if self.halves:
            y, x = (F.avg_pool2d(value, 2, ceil_mode=True) for value in (y, x))
        if self.downsample is not None:
            x = self.downsample["1"](self.downsample["0"](x))
        return F.relu(self.bn3(self.conv3(y)) + x)


class CLIPTrunk(nn.Module):
    """Color in, features of CLIP at a quarter to a 32nd of the resolution out."""

    def __init__(self, width: int = 64, blocks: tuple[int, ...] = (3, 4, 6, 3)) -> None:
        """Make the weights.

        Args:
            width: Channels behind the stem; 64 in RN50.
            blocks: Blocks of each of the four stages.
        """
        super().__init__()
        self.conv1 = nn.Conv2d(3, width // 2, 3, stride=2, padding=1, bias=False)
        self.bn1 = nn.BatchNorm2d(width // 2)
        self.conv2 = nn.Conv2d(width // 2, width // 2, 3, padding=1, bias=False)
        self.bn2 = nn.BatchNorm2d(width // 2)
        self.conv3 = nn.Conv2d(width // 2, width, 3, padding=1, bias=False)
        self.bn3 = nn.BatchNorm2d(width)
        channels = width
        for stage, count in enumerate(blocks):
            narrow = width * 2**stage
            layers = []
            for number in range(count):
                halves = stage > 0 and number == 0
                layers.append(_Bottleneck(channels, narrow, halves))
                channels = narrow * _EXPANSION
            self.add_module(f"layer{stage + 1}", nn.Sequential(*layers))
        self.widths = tuple(width * 2**s * _EXPANSION for s in range(_STAGES))
        self.mean: Tensor
        self.deviation: Tensor
        for name, values in (("mean", _MEAN), ("deviation", _DEVIATION)):
            self.register_buffer(
                name, torch.tensor(values).view(3, 1, 1), persistent=False
            )
        self.requires_grad_(False)
        self.eval()

    def train(self, mode: bool = True) -> "CLIPTrunk":
        """Stay as it is: statistics are never updated."""
        del mode
        return super().train(False)

    def forward(self, color: Tensor) -> list[Tensor]:
        """Map color from -1 to 1, (B, 3, H, W), to features of the four stages."""
        x = ((color + 1.0) / 2.0 - self.mean) / self.deviation
        for i in (1, 2, 3):
            x = F.relu(getattr(self, f"bn{i}")(getattr(self, f"conv{i}")(x)))
        x = F.avg_pool2d(x, 2)
        found = []
        for stage in range(_STAGES):
            x = getattr(self, f"layer{stage + 1}")(x)
            found.append(x)
        return found

    @classmethod
    def load(cls, path: str | Path) -> "CLIPTrunk":
        """Read weights in OpenAI's format: the model as published, or its tensors.

        Args:
            path: A TorchScript archive such as ``RN50.pt``, or a file of tensors by
                name, those of the image encoder beginning with ``visual.``.

        Raises:
            InvalidConfigError: There is no such file, or it is no CLIP ResNet.
        """
        tensors = _visual(_read(Path(path)))
        needed = ("conv3.weight", "layer1.0.conv1.weight", "layer4.0.conv1.weight")
        if any(name not in tensors for name in needed):
            raise InvalidConfigError(
                f"{path} holds no ResNet of CLIP: {needed[0]!r} and the like are "
                "missing. Give the weights of RN50 or RN101, not of a vision "
                "transformer."
            )
        blocks = tuple(
            1
            + max(
                int(match[1])
                for name in tensors
                if (match := re.match(rf"layer{stage}\.(\d+)\.", name))
            )
            for stage in range(1, _STAGES + 1)
        )
        trunk = cls(tensors["conv3.weight"].shape[0], blocks)
        wanted = trunk.state_dict()
        wrong = [
            name
            for name, value in wanted.items()
            if name not in tensors or tensors[name].shape != value.shape
        ]
        if wrong:
            raise InvalidConfigError(
                f"{path} does not fit a ResNet of CLIP with {trunk.widths[0] // 4} "
                f"channels: {', '.join(wrong[:3])} are missing or of another shape. "
                "Download it again."
            )
        trunk.load_state_dict({name: tensors[name].float() for name in wanted})
        return trunk


def _read(path: Path) -> Mapping[str, Tensor]:
    if not path.is_file():
        raise InvalidConfigError(
            f"There are no CLIP weights at {path}. Download RN50.pt from OpenAI's CLIP "
            "repository, or leave 'clip_weights' empty to train without them."
        )
    try:
        found = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as plain:
        try:
            found = _read_archive(path)
        except Exception:
            raise InvalidConfigError(
                f"{path} holds no tensors that torch can read: {plain}. Give RN50.pt "
                "as published, or its state_dict saved by torch.save."
            ) from plain
    if isinstance(found, nn.Module):
        return found.state_dict()
    if isinstance(found, Mapping):
        inner = found.get("state_dict", found)
        if isinstance(inner, Mapping):
            return inner
    raise InvalidConfigError(
        f"{path} holds {type(found).__name__}, no tensors by name."
    )


def _read_archive(path: Path) -> nn.Module:
    with warnings.catch_warnings():
        # TorchScript is deprecated, and the form in which the weights are published.
        warnings.simplefilter("ignore", DeprecationWarning)
        found: nn.Module = torch.jit.load(str(path), map_location="cpu")  # type: ignore[no-untyped-call]
    return found


def _visual(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return the tensors of the image encoder, named as in :class:`CLIPTrunk`."""
    return {
        name.removeprefix(_PREFIX): value
        for name, value in tensors.items()
        if isinstance(value, Tensor)
        and (
            name.startswith(_PREFIX) or not any(n.startswith(_PREFIX) for n in tensors)
        )
    }
