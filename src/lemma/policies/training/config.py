"""Options of a training run, and the defaults of each model.

Plain data without torch, so that the command line shows its help quickly.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import tyro

from lemma.core.arguments import Share, check_ranges, decode
from lemma.core.errors import InvalidConfigError

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
PositiveShare = Annotated[float, msgspec.Meta(gt=0.0, le=1.0)]
Level = Annotated[float, msgspec.Meta(ge=0.0)]
"""0 for none."""
Whole = Annotated[int, msgspec.Meta(ge=0)]
"""0 for none."""
# Without the hint "(default: None)": the help texts state the defaults.
Count = Annotated[
    Annotated[int, msgspec.Meta(ge=1)] | None,
    tyro.conf.arg(metavar="N", help_behavior_hint=""),
]
Amount = Annotated[Positive | None, tyro.conf.arg(metavar="X", help_behavior_hint="")]
Part = Annotated[
    PositiveShare | None, tyro.conf.arg(metavar="X", help_behavior_hint="")
]
Name = Annotated[str | None, tyro.conf.arg(metavar="WEIGHTS", help_behavior_hint="")]
Kinds = Annotated[
    tuple[Literal["high_level", "human"], ...], msgspec.Meta(min_length=1)
]
RECOVERY_SHARE = 0.25
"""Default share of recovery states."""


@dataclass(frozen=True, kw_only=True)
class Augmentation:
    """Random changes of training frames; each can be disabled."""

    palette: bool = True
    """Exchange the five colors of cubes and pads, in images, labels and sentences."""
    templates: bool = True
    """Draw a new sentence each time; otherwise an episode keeps its first one."""
    paraphrases: Level = 0.7
    """Share of sentences that differ from all templates, from a grammar or recombined
    from parts of templates; 0 for none."""
    relational: Share = 0.0
    """Share of frames whose sentence names things by their places in the frame, for
    models that read it with the scene."""
    translate_cells: Whole = 6
    """Largest shift of the scene, in cells of the map; 0 for none."""
    turn: bool = True
    """Turn the scene by half a turn at random; the robots then exchange numbers."""
    rotate_deg: Level = 0.0
    """Largest rotation of the scene about the middle of the map [deg]; 0 for none.
    Scenes with a gap stay, and so do those whose next motion would leave the map, or
    in which the robots of a pair would exchange sides."""
    brightness: Share = 0.15
    """Largest change of brightness and of contrast, as a share; 0 for none."""
    pixel_noise: Level = 0.03
    """Largest standard deviation of noise in colors from 0 to 1; 0 for none."""
    height_noise_m: Level = 0.003
    """Largest standard deviation of noise in heights [m]; 0 for none."""
    dropouts: Whole = 4
    """Largest number of small holes in the images; 0 for none."""

    # `TrainingConfig` checks the numbers, because tyro rewrites errors raised here.

    @classmethod
    def none(cls) -> "Augmentation":
        """Return the options that change nothing."""
        # False, 0 and 0.0.
        return cls(**{name: type(value)() for name, value in asdict(cls()).items()})


@dataclass(frozen=True)
class TrainingConfig:
    """Options of a training run."""

    model: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL")]
    """episodic-transformer, cliport, m-cliport, reachnet, team-reachnet or keypose."""
    data: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder of keyframes that lemma render --form keyframes wrote; for keypose, --form
    key-poses."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder of the run. An unfinished run in it is continued."""
    options: Annotated[
        tuple[str, ...],
        tyro.conf.arg(metavar="NAME=VALUE ...", help_behavior_hint=""),
    ] = ()
    """Options of the model, such as width=128."""
    seed: int = 0
    """Seed of initial weights, order of samples, sentences and augmentation."""
    start: Name = None
    """Initial weights, by name or file, instead of random ones."""

    steps: Count = None
    """Steps of the optimizer. By default the model's own number of samples."""
    samples: Count = None
    """Total number of frames, or episodes, to draw; replaces steps."""
    batch_size: Count = None
    """Frames, or episodes, in a batch of one GPU. By default the model's own."""
    learning_rate: Amount = None
    """Peak learning rate of AdamW. By default the model's own."""
    warmup_steps: Whole = 300
    """Steps of linear warm-up to the peak learning rate; a cosine decay to zero
    follows."""
    weight_decay: Level = 0.02
    """Weight decay of AdamW, for matrices and kernels only."""
    clip: Positive = 1.0
    """Largest norm of the gradient."""
    ema: Share = 0.999
    """Decay of the moving average of the weights; the average is saved."""

    precision: Literal["bf16", "float32"] = "bf16"
    """Number format of the network on a GPU; on a CPU it is float32."""
    channels_last: bool = True
    """Use the channels-last memory format in convolutions."""
    compile: bool = True
    """Compile the networks on a GPU: a minute more to start, faster to run."""
    capture: bool = True
    """Run a step on a GPU as one CUDA graph, for models with fixed shapes."""
    device: Literal["auto", "cuda", "cpu"] = "auto"
    """Device to train on; auto: a GPU if there is one."""
    images: Literal["auto", "device", "host"] = "auto"
    """Memory for the images; auto: the device if they need less than a tenth of its
    memory."""
    shared_images: bool = False
    """Read images from uncompressed files that all runs on this machine share; the
    first run writes them beside the data."""

    val_every: Count = None
    """Steps between validations. By default ten in all."""
    checkpoint_every_s: Positive = 60.0
    """Seconds between checkpoints."""
    time_limit_s: Amount = None
    """Time limit of the training in seconds, summed over continued runs; the learning
    rate reaches zero at that time. The number of steps then depends on the machine,
    which the weights record, so use it only for experiments."""
    train_split: str = "train"
    """Split to train on."""
    val_split: str = "val"
    """Split for the selection of the best weights."""
    tasks: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="TASK ...", help_behavior_hint="")
    ] = ()
    """Names of tasks; all if empty."""
    episodes: Count = None
    """Number of episodes of the split to train on, drawn with the seed."""
    episodes_per_task: Count = None
    """Number of episodes of every task to train on, the first ones."""
    kinds: Kinds = ("high_level", "human")
    """Kinds of instructions, drawn with equal probability."""
    language: Literal["full", "none", "shuffled"] = "full"
    """Control experiments. none: empty sentences; shuffled: sentences of other
    episodes."""
    augmentation: Augmentation = field(default_factory=Augmentation)
    """Random changes of frames."""
    recovery: Annotated[
        Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")
    ] = None
    """Folder of recovery states to mix in: rendered keyframes of perturbed executions
    from lemma generate --perturb. They are never used for validation."""
    recovery_share: Part = None
    """Share of recovery states in each batch of frames or episodes; 0.25 by default."""
    track: bool = False
    """Log to wandb as well as to TensorBoard."""

    def __post_init__(self) -> None:
        """Check numbers and names."""
        check_ranges(self)
        if self.steps is not None and self.samples is not None:
            raise InvalidConfigError(
                "steps and samples both set the length of training. Leave out one of "
                "them."
            )
        if self.episodes is not None and self.episodes_per_task is not None:
            raise InvalidConfigError(
                "episodes and episodes_per_task both select episodes. Leave out one of "
                "them."
            )
        if self.recovery_share is not None and self.recovery is None:
            raise InvalidConfigError(
                "recovery_share is the share of recovery states in each batch, but "
                "there are none. Name them with --recovery DIR."
            )

    def resolved(self, processes: int = 1) -> "TrainingConfig":
        """Return the same options, with the model's defaults in place of None.

        Args:
            processes: Number of processes of a distributed run; each draws a batch.
        """
        own = DEFAULTS.get(self.model, Defaults())
        batch_size = self.batch_size or own.batch_size
        steps = self.steps or -(-(self.samples or own.samples) // batch_size)
        if self.steps is None:
            steps = -(-steps // processes)
        return replace(
            self,
            steps=steps,
            samples=None,
            batch_size=batch_size,
            learning_rate=self.learning_rate or own.learning_rate,
            val_every=self.val_every or max(1, steps // 10),
            recovery_share=self.recovery_share
            or (RECOVERY_SHARE if self.recovery else None),
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON."""
        data: dict[str, Any] = json.loads(json.dumps(asdict(self), default=str))
        return data

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "TrainingConfig":
        """Make options from the data that :meth:`to_dict` returned.

        Raises:
            UnknownNameError: This version has no option of that name.
            InvalidConfigError: The value of an option is invalid.
        """
        return decode(cls, data)


@dataclass(frozen=True)
class Defaults:
    """Defaults of a model."""

    samples: int = 320_000
    """Total number of frames, or episodes, to draw."""
    batch_size: int = 64
    """Frames, or episodes, in a batch."""
    learning_rate: float = 3e-4
    """Peak learning rate."""


DEFAULTS: dict[str, Defaults] = {
    # Thirty epochs, as in the paper, and until the score no longer rises.
    "episodic-transformer": Defaults(samples=168_000, batch_size=32),
    "cliport": Defaults(samples=600_000, learning_rate=1e-3),
    "m-cliport": Defaults(samples=600_000, learning_rate=1e-3),
    "keypose": Defaults(samples=300_000, batch_size=64, learning_rate=1e-3),
    "reachnet": Defaults(samples=300_000, batch_size=128, learning_rate=1e-3),
    "team-reachnet": Defaults(samples=200_000, batch_size=128, learning_rate=1e-3),
}
"""Defaults by name of the model."""

MAY_CHANGE = (
    *("data", "recovery", "out", "device", "compile", "capture", "images"),
    *("shared_images", "checkpoint_every_s", "time_limit_s", "val_every", "track"),
)
"""Options that may change when a run is continued."""


def model_options(words: tuple[str, ...]) -> dict[str, Any]:
    """Return the options of a model from the command line as plain data.

    The names are checked later, when the options are decoded.

    Args:
        words: Such as ``("width=128", "reader.layers=2")``.

    Raises:
        InvalidConfigError: An option has no value, or is a part that another option
            already sets.
    """
    chosen: dict[str, Any] = {}
    for word in words:
        name, equals, text = word.partition("=")
        *outer, last = name.split(".")
        place: Any = chosen
        for step in outer:
            place = place.setdefault(step, {}) if isinstance(place, dict) else None
        if not (equals and isinstance(place, dict)):
            raise InvalidConfigError(
                f"{word!r} has no value, or conflicts with another. Write options as "
                "NAME=VALUE, or PART.NAME=VALUE, such as reader.layers=2."
            )
        try:
            place[last] = json.loads(text)
        except ValueError:
            place[last] = text
    return chosen
