"""Every row of every table, and every training that they need, as data."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from lemma.core.errors import UnknownNameError
from lemma.core.registry import Registry
from lemma.evaluation.experiments import paper_figures as paper
from lemma.evaluation.experiments.paper_figures import Figures
from lemma.policies.class_path import LEROBOT, LEROBOT_PRIVILEGED
from lemma.policies.spec import ORACLE, PolicySpec
from lemma.policies.training.config import DEFAULTS
from lemma.tasks.instance import BENCHMARK_VERSION
from lemma.tasks.language.template import EVALUATION_KINDS
from lemma.tasks.suite import SUITE

CONTROL_LEVEL = "control-level"
SUITES = ("paper", "ours", "controls", CONTROL_LEVEL, "ablations")
ALL = "all"
SEEDS = (0, 1, 2)
"""Seeds of training; the weights of the first ship."""
ABLATIONS = "ablations"
ABLATION_EPISODES = 100
"""Demonstrations of each task that ablations are trained on: with all 700 of them, what
is left out is hardly missed."""
_RECIPE = f"data/lemma-{BENCHMARK_VERSION}"
DATA = f"{_RECIPE}-keyframes"
RECOVERY = f"{_RECIPE}-recovery-keyframes"
DATA_COMMANDS = (
    f"lemma generate --out {_RECIPE}",
    f"lemma render {_RECIPE} --form keyframes --out {DATA}",
    f"lemma generate --perturb 0.3 --episodes 150 --out {_RECIPE}-recovery",
    f"lemma render {_RECIPE}-recovery --form keyframes --out {RECOVERY}",
)
"""Make what all trainings need."""


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """One policy whose success is reported."""

    name: str
    """Folder of its results."""
    title: str
    """In tables."""
    suite: str
    """One of :data:`SUITES`."""
    policy: PolicySpec
    """Its parts are names of trainings."""
    kinds: tuple[str, ...] = EVALUATION_KINDS
    """Kinds of instructions."""
    language: str = "full"
    """The sentence, one of
    :data:`lemma.evaluation.protocol.language_controls.LANGUAGES`."""
    perturb_start: bool = False
    """Whether objects begin a little elsewhere."""
    tasks: tuple[str, ...] = SUITE
    """Which ones it is played on."""
    training: str = ""
    """The command that makes its weights, where ``lemma train`` does not."""
    paper: Mapping[str, Figures] = field(default_factory=dict)
    """By kind; what the paper reports for this row."""

    def runs(self, seed: int) -> str:
        """Return the folder that :meth:`Training.command` puts its weights into."""
        return f"runs/{ABLATIONS}" if self.suite == ABLATIONS else f"runs/seed-{seed}"

    def summary_path(self, out: Path, seed: int) -> Path:
        """Return the file of its result with one training seed."""
        if self.suite == ABLATIONS:
            return out / ABLATIONS / f"{self.name}.json"
        return out / self.name / f"seed-{seed}.json"


@dataclass(frozen=True)
class Training:
    """How the weights of one name are made."""

    name: str
    """Name of the weights."""
    model: str
    """As ``lemma train`` knows it."""
    arguments: str = ""
    """Besides data, folder, seed and number of samples."""
    recovery: bool = True
    """Whether recovery states are mixed in."""
    samples: int | None = None
    """If others than the model's own."""

    def command(self, runs: str, seed: int) -> str:
        """Return the command line; what it trains is counted in samples alone.

        Args:
            runs: Folder of the runs; each has the name of its weights.
            seed: Seed of the training.
        """
        words = [f"lemma train {self.model} --data {DATA}"]
        if self.recovery:
            words.append(f"--recovery {RECOVERY}")
        words.append(f"--out {runs}/{self.name} --seed {seed}")
        # Spelled out, so that a line stays true where the model's own number changes.
        words.append(f"--samples {self.samples or DEFAULTS[self.model].samples}")
        if self.arguments:
            words.append(self.arguments)
        return " ".join(words)


EXPERIMENTS: Registry[Experiment] = Registry("experiment", Experiment)
"""By name, in the order of the tables."""
TRAININGS: Registry[Training] = Registry("training", Training)
"""By name of the weights."""


def selected(name: str) -> list[Experiment]:
    """Return the experiments of a suite, all of them, or the one of that name.

    ``"all"`` means those whose weights ship, and that need no other environment:
    neither the ablations nor those at control level.

    Raises:
        UnknownNameError: There is neither a suite nor an experiment of that name.
    """
    if name in EXPERIMENTS:
        return [EXPERIMENTS[name]]
    if name not in (*SUITES, ALL):
        raise UnknownNameError(
            "experiment or suite", name, (*SUITES, ALL, *EXPERIMENTS)
        )
    every = [EXPERIMENTS[each] for each in EXPERIMENTS]
    if name == ALL:
        return [one for one in every if one.suite not in (ABLATIONS, CONTROL_LEVEL)]
    return [one for one in every if one.suite == name]


def _add(experiment: Experiment) -> None:
    EXPERIMENTS.add(experiment.name, experiment)


_TWO_LEVELS = "episodic-transformer+cliport"
for _planning, _gta, _figures in (
    ("single-step", False, paper.SINGLE_STEP),
    ("single-step", True, paper.SINGLE_STEP_GTA),
    ("multi-step", False, paper.MULTI_STEP),
    ("multi-step", True, paper.MULTI_STEP_GTA),
):
    _add(
        Experiment(
            name=f"et-cliport-{_planning}{'-gta' * _gta}",
            title=f"ET + CLIPort, {_planning}{' + GTA' * _gta}",
            suite="paper",
            policy=PolicySpec(_TWO_LEVELS, _planning, _gta),
            paper=_figures,
        )
    )
_add(
    Experiment(
        name="m-cliport",
        title="M-CLIPort",
        suite="paper",
        policy=PolicySpec("m-cliport"),
        paper=paper.M_CLIPORT,
    )
)
_add(
    Experiment(
        name="reachnet",
        title="ReachNet",
        suite="ours",
        policy=PolicySpec("reachnet"),
    )
)
_add(
    Experiment(
        name="reachnet-demonstrations",
        title="ReachNet, reach from demonstrations alone",
        suite="ours",
        policy=PolicySpec("reachnet-demonstrations"),
    )
)
for _name, _title, _policy in (
    ("oracle", "the expert", PolicySpec(ORACLE)),
    (
        "et-oracle",
        "ET + the expert's poses",
        PolicySpec(f"episodic-transformer+{ORACLE}"),
    ),
    ("oracle-cliport", "the expert's plan + CLIPort", PolicySpec(f"{ORACLE}+cliport")),
    ("reachnet-gta", "ReachNet + GTA", PolicySpec("reachnet", gta=True)),
    (
        "reachnet-oracle",
        "ReachNet's plan + the expert's poses",
        PolicySpec(f"reachnet+{ORACLE}"),
    ),
):
    _add(Experiment(name=_name, title=_title, suite="controls", policy=_policy))
for _language, _title in (
    ("none", "ReachNet, told nothing"),
    ("shuffled", "ReachNet, told what belongs to another instance"),
    ("swapped", "ReachNet, told other colors"),
):
    _add(
        Experiment(
            name=f"reachnet-told-{_language}",
            title=_title,
            suite="controls",
            policy=PolicySpec("reachnet"),
            language=_language,
        )
    )

_add(
    Experiment(
        name="reachnet-perturbed-start",
        title="ReachNet, perturbed starts",
        suite="controls",
        policy=PolicySpec("reachnet"),
        perturb_start=True,
    )
)

CONTROL_TASKS = ("pass", "stack", "poke", "hook")
"""Tasks of the policies at control level; one policy for all of them."""
_BASELINES = "python scripts/control_baselines.py --policies"
_AS_TRAINED = (
    f"{_BASELINES} act,diffusion "
    "--cameras robot_0,robot_1,robot_0_wrist,robot_1_wrist --size 128x96 "
    "--batch 128 --train-s 651"
)
"""The command that trained on camera images: both at a time, on one GPU."""
for _learner, _called in (("act", "ACT"), ("diffusion", "Diffusion Policy")):
    _add(
        Experiment(
            name=_learner,
            title=f"{_called}, camera images",
            suite=CONTROL_LEVEL,
            policy=PolicySpec(f"{LEROBOT}{_learner}", arguments=(("hz", 5),)),
            tasks=CONTROL_TASKS,
            training=_AS_TRAINED,
        )
    )
    _add(
        Experiment(
            name=f"{_learner}-privileged",
            title=f"{_called}, told poses and goal",
            suite=CONTROL_LEVEL,
            policy=PolicySpec(
                f"{LEROBOT_PRIVILEGED}{_learner}-privileged", arguments=(("hz", 5),)
            ),
            # It is given the goal, independent of the sentence.
            kinds=EVALUATION_KINDS[:1],
            tasks=CONTROL_TASKS,
            training=f"{_BASELINES} {_learner} --observation privileged",
        )
    )

for _model in ("episodic-transformer", "cliport", "m-cliport", "reachnet"):
    TRAININGS.add(_model, Training(_model, _model))
TRAININGS.add(
    "reachnet-demonstrations",
    Training("reachnet-demonstrations", "reachnet", "--options reach=demonstrations"),
)

_ABLATED = "reachnet"
_ABLATION_SAMPLES = 100_000
"""Samples of each ablation; fewer than the model's own, because there are many."""
_AUGMENTATIONS = {
    "no-palette": ("no palette swap", "--augmentation.no-palette"),
    "no-templates": ("no template resampling", "--augmentation.no-templates"),
    "no-paraphrases": ("no paraphrases", "--augmentation.paraphrases 0"),
    "no-translation": ("no translation", "--augmentation.translate-cells 0"),
    "no-turn": ("no half turn", "--augmentation.no-turn"),
    "no-color-noise": (
        "no image noise",
        "--augmentation.brightness 0 --augmentation.pixel-noise 0",
    ),
    "no-height-noise": ("no height noise", "--augmentation.height-noise-m 0"),
    "no-dropouts": ("no holes", "--augmentation.dropouts 0"),
}
"""Parts that can be left out: title and arguments of the training."""


def _add_ablation(
    name: str,
    title: str,
    arguments: str = "",
    *,
    recovery: bool = True,
    language: str = "full",
) -> None:
    weights = f"{_ABLATED}-{name}"
    few = f"--episodes-per-task {ABLATION_EPISODES}"
    training = Training(
        weights, _ABLATED, f"{few} {arguments}".strip(), recovery, _ABLATION_SAMPLES
    )
    TRAININGS.add(weights, training)
    _add(
        Experiment(
            name=name,
            title=title,
            suite=ABLATIONS,
            policy=PolicySpec(weights),
            language=language,
        )
    )


_add_ablation("complete", "nothing left out")
for _name, (_title, _arguments) in _AUGMENTATIONS.items():
    _add_ablation(_name, _title, _arguments)
_add_ablation(
    "no-augmentation",
    "no augmentation at all",
    " ".join(arguments for _, arguments in _AUGMENTATIONS.values()),
)
_add_ablation("no-recovery", "no recovery states", recovery=False)
_add_ablation("no-reach", "no reach", "--options reach=none")
_add_ablation(
    "no-language",
    "control: no language",
    "--language none --options reader.guesses=true",
    language="none",
)
_add_ablation("shuffled-language", "control: shuffled language", "--language shuffled")
