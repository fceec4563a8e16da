"""Every row of every table, and every training that they need.

They are data, in ``experiments.toml``, with all tables of the paper (arXiv 2308.00937).
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import msgspec

from lemma.core.errors import UnknownNameError
from lemma.policies.spec import PolicySpec
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
_ABLATED = "reachnet"
_ABLATION_SAMPLES = 100_000
"""Samples of each ablation; fewer than the model's own, because there are many."""
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
TEAMS = ("ur5+ur5", "ur5+ur10", "ur10+ur10")
"""In the order of the paper's tables."""
_NONE: Mapping[str, str] = {}


@dataclass(frozen=True, slots=True)
class Measured:
    """One figure of the paper [%]."""

    mean: float
    std: float

    def __str__(self) -> str:
        """Return it as it is printed there."""
        return f"{self.mean:.2f} ± {self.std:.2f}"


@dataclass(frozen=True)
class Figures:
    """Figures of the paper for one policy and kind of instructions."""

    mean: Measured
    """Mean over the eight tasks."""
    tasks: Mapping[str, Measured]
    """By task."""
    teams: Mapping[str, Measured]
    """By types of the robots, if there are some."""
    distractors: Mapping[str, Mapping[int, Measured]]
    """By task and number of distractors."""

    @classmethod
    def read(
        cls, tasks: str, teams: str = "", distractors: Mapping[str, str] = _NONE
    ) -> "Figures":
        """Return a row as it is printed there: ``"34.33±2.19 0.00±0.00"``."""
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
        """Return the figure of some episodes, if the paper has it; else of all."""
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

    @property
    def decides(self) -> tuple[dict[str, Any], str, bool]:
        """Policy, language and start, as settings of its results say them."""
        return self.policy.about(), self.language, self.perturb_start

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


def _read() -> tuple[dict[str, Experiment], dict[str, Training]]:
    """Return what the file holds: experiments and trainings by name, in its order."""
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
"""By name, in the order of the tables; and by name of the weights."""
CONTROL_TASKS = EXPERIMENTS["act"].tasks
"""Tasks of the policies at control level; one policy for all of them."""


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
