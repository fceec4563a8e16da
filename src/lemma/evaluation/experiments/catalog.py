"""The experiments of all tables, and their trainings.

They are data in ``experiments.toml``, with all tables of the paper (arXiv 2308.00937).
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import msgspec

from lemma.core.arguments import known
from lemma.policies.spec import PolicySpec
from lemma.policies.training.config import DEFAULTS
from lemma.tasks.instance import BENCHMARK_VERSION
from lemma.tasks.language.template import EVALUATION_KINDS
from lemma.tasks.suite import SUITE

CONTROL_LEVEL = "control-level"
SUITES = ("paper", "reachnet-variants", "controls", CONTROL_LEVEL, "ablations")
ALL = "all"
AND = " && "
"""Between commands of a line."""
SEEDS = (0, 1, 2)
"""Training seeds; the published weights have the first one."""
ABLATIONS = "ablations"
ABLATION_EPISODES = 100
"""Demonstrations of each task for ablations; with all 700 the differences are small."""
_ABLATED = "reachnet"
_ABLATION_SAMPLES = 100_000
"""Training samples of each ablation; fewer than the model's default, to save time."""
_RECIPE = f"data/lemma-{BENCHMARK_VERSION}"
DATA = f"{_RECIPE}-keyframes"
RECOVERY = f"{_RECIPE}-recovery-keyframes"
DATA_COMMANDS = (
    f"lemma generate --out {_RECIPE}",
    f"lemma render {_RECIPE} --form keyframes --out {DATA}",
    f"lemma generate --perturb 0.3 --episodes 150 --out {_RECIPE}-recovery",
    f"lemma render {_RECIPE}-recovery --form keyframes --out {RECOVERY}",
)
"""Commands that make the data of all trainings."""
TEAMS = ("ur5+ur5", "ur5+ur10", "ur10+ur10")
"""Teams in the order of the paper's tables."""
_SEED = "{seed}"
_NONE: Mapping[str, str] = {}


@dataclass(frozen=True, slots=True)
class Measured:
    """One figure of the paper [%]."""

    mean: float
    std: float

    def __str__(self) -> str:
        """Return the figure as in the paper."""
        return f"{self.mean:.2f} ± {self.std:.2f}"


@dataclass(frozen=True)
class Figures:
    """Figures of the paper for one policy and kind of instructions."""

    mean: Measured
    """Mean over the eight tasks."""
    tasks: Mapping[str, Measured]
    """Figures by task."""
    teams: Mapping[str, Measured]
    """Figures by team, if the paper has them."""
    distractors: Mapping[str, Mapping[int, Measured]]
    """Figures by task and number of distractors."""

    @classmethod
    def read(
        cls, tasks: str, teams: str = "", distractors: Mapping[str, str] = _NONE
    ) -> "Figures":
        """Parse rows of the paper's tables: ``"34.33±2.19 0.00±0.00"``."""
        *each, mean = _measured(tasks)
        return cls(
            mean,
            dict(zip(SUITE, each, strict=True)),
            dict(zip(TEAMS, _measured(teams), strict=bool(teams))),
            {
                task: dict(enumerate(_measured(row)))
                for task, row in distractors.items()
            },
        )

    def of(
        self, task: str = "", team: str = "", distractors: int | None = None
    ) -> Measured | None:
        """Return the figure of a task, team or number of distractors; None if missing.

        Without arguments it is the mean over all tasks.
        """
        if distractors is not None:
            return self.distractors.get(task, {}).get(distractors)
        if team:
            return self.teams.get(team)
        return self.tasks.get(task) if task else self.mean


def _measured(text: str) -> list[Measured]:
    pairs = (word.split("±") for word in text.split())
    return [Measured(float(mean), float(std)) for mean, std in pairs]


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """One policy whose success is reported."""

    name: str
    """Name of the experiment and of the folder of its results."""
    title: str
    """Title in tables."""
    suite: str
    """One of :data:`SUITES`."""
    policy: PolicySpec
    """The policy; its parts are names of trainings."""
    kinds: tuple[str, ...] = EVALUATION_KINDS
    """Kinds of instructions."""
    language: str = "full"
    """The language control, one of
    :data:`lemma.evaluation.protocol.language_controls.LANGUAGES`."""
    perturb_start: bool = False
    """Whether episodes begin at perturbed starts."""
    tasks: tuple[str, ...] = SUITE
    """Names of its tasks."""
    training: str = ""
    """The commands that make its weights, with ``&&`` between them, if they learn from
    other data than those of :data:`TRAININGS`; ``{seed}`` stands for the seed."""
    paper: Mapping[str, Figures] = field(default_factory=dict)
    """The paper's figures for this row, by kind of instructions."""

    @property
    def decides(self) -> tuple[dict[str, Any], str, bool]:
        """Policy, language and start, as in the settings of its results."""
        return self.policy.about(), self.language, self.perturb_start

    @property
    def seeds(self) -> tuple[int, ...]:
        """Seeds with which its own commands train; only the first if they name none."""
        return SEEDS if _SEED in self.training else SEEDS[:1]

    def trainings(self, seed: int) -> list[str]:
        """Return its own commands, in their order, for one training seed."""
        own = self.training.replace(_SEED, str(seed))
        return own.split(AND) if own else []

    def runs(self, seed: int) -> str:
        """Return the folder of the runs of its trainings."""
        return f"runs/{ABLATIONS}" if self.suite == ABLATIONS else f"runs/seed-{seed}"

    def summary_path(self, out: Path, seed: int) -> Path:
        """Return the file of its result for one training seed."""
        if self.suite == ABLATIONS:
            return out / ABLATIONS / f"{self.name}.json"
        return out / self.name / f"seed-{seed}.json"


@dataclass(frozen=True)
class Training:
    """The training of the weights of one name."""

    name: str
    """Name of the weights."""
    model: str
    """Name of the model, as in ``lemma train``."""
    arguments: str = ""
    """Further arguments besides data, folder, seed and number of samples."""
    recovery: bool = True
    """Whether recovery states are mixed in."""
    samples: int | None = None
    """Number of samples; the model's default if None."""
    then: str = ""
    """A further command that changes the weights in the folder ``{run}``."""

    def commands(self, runs: str, seed: int) -> tuple[str, ...]:
        """Return all command lines, in their order; see :meth:`command`."""
        run = f"{runs}/{self.name}"
        then = (self.then.format(run=run, seed=seed),) if self.then else ()
        return (self.command(runs, seed), *then)

    def command(self, runs: str, seed: int) -> str:
        """Return the command line, with the length of training as samples.

        Args:
            runs: Folder of the runs; each has the name of its weights.
            seed: Seed of the training.
        """
        words = [f"lemma train {self.model} --data {DATA}"]
        if self.recovery:
            words.append(f"--recovery {RECOVERY}")
        words.append(f"--out {runs}/{self.name} --seed {seed}")
        # Explicit, so that a change of the model's default does not affect the command.
        words.append(f"--samples {self.samples or DEFAULTS[self.model].samples}")
        if self.arguments:
            words.append(self.arguments)
        return " ".join(words)


def _read() -> tuple[dict[str, Experiment], dict[str, Training]]:
    """Return the file's experiments and trainings by name, in its order."""
    path = files("lemma.evaluation.experiments") / "experiments.toml"
    data = tomllib.loads(path.read_text("utf-8"))
    experiments = []
    for entry in data["experiment"]:
        row = data["paper"].get(entry.pop("paper", ""), {})
        figures = {kind: Figures.read(**printed) for kind, printed in row.items()}
        one = msgspec.convert(entry, Experiment)
        experiments.append(replace(one, paper=figures))
    trainings = [Training(**entry) for entry in data["training"]]
    for entry in data["ablation"]:
        weights = f"{_ABLATED}-{entry['name']}"
        few = f"--episodes-per-task {ABLATION_EPISODES} {entry.pop('arguments', '')}"
        made = (_ABLATED, few.strip(), entry.pop("recovery", True), _ABLATION_SAMPLES)
        trainings.append(Training(weights, *made))
        policy = PolicySpec(weights)
        experiments.append(Experiment(suite=ABLATIONS, policy=policy, **entry))
    return (
        {experiment.name: experiment for experiment in experiments},
        {training.name: training for training in trainings},
    )


EXPERIMENTS, TRAININGS = _read()
"""Experiments by name, in the order of the tables; trainings by name of the weights."""


def selected(name: str) -> list[Experiment]:
    """Return the experiments of a suite, all of them, or the one of that name.

    ``"all"`` means those with published weights that need no other environment, so
    neither the ablations nor those at control level.

    Raises:
        UnknownNameError: There is neither a suite nor an experiment of that name.
    """
    if name in EXPERIMENTS:
        return [EXPERIMENTS[name]]
    known("experiment or suite", name, (*SUITES, ALL, *EXPERIMENTS))
    every = [EXPERIMENTS[each] for each in EXPERIMENTS]
    if name == ALL:
        return [one for one in every if one.suite not in (ABLATIONS, CONTROL_LEVEL)]
    return [one for one in every if one.suite == name]
