"""Reproduction of experiments, from weights to the files of the tables.

A check compares policies with published lines: sub-tasks, outcomes and poses.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from lemma.core.errors import DatasetError, InvalidConfigError
from lemma.core.files import read_json, temporary_folder
from lemma.core.workers.pool import Engine
from lemma.evaluation.analysis.result import summarise
from lemma.evaluation.experiments.catalog import (
    ABLATIONS,
    AND,
    DATA_COMMANDS,
    SEEDS,
    TRAININGS,
    Experiment,
    Training,
)
from lemma.evaluation.lines import lines_at, packed_beside, read_lines, write_packed
from lemma.evaluation.records import ABOUT, Row, key_of, training_seed
from lemma.evaluation.run.config import EvaluationConfig
from lemma.evaluation.run.evaluate import evaluate
from lemma.evaluation.run.loading import learned_parts, weights_of
from lemma.policies.class_path import checkpoint_of
from lemma.policies.spec import DEVICES, PolicySpec
from lemma.policies.weights import published_weights

_FILE = "weights.safetensors"
_CHECKPOINT = "checkpoints/last/pretrained_model/model.safetensors"
"""File of the policy's weights in a training run of LeRobot."""
SHIPPED = SEEDS[0]
"""Training seed of the published weights."""
TOLERANCE_M = 0.001
TOLERANCE_RAD = 0.01
"""Tolerances of poses, because images of another renderer change a network's poses; all
else must be equal."""


class MissingWeightsError(DatasetError):
    """The weights of an experiment are missing."""


@dataclass(frozen=True, kw_only=True)
class Reproduction:
    """Options of a reproduction."""

    out: Path
    """Folder of all results."""
    weights: Path | None = None
    """Folder with the run of each training, by name; published weights if None."""
    split: str = "test"
    episodes: int | None = None
    """Number of episodes of every task, the first ones; all if None."""
    device: str = DEVICES[0]
    """Device of the models. Experiments without models run without it."""

    def config(self, experiment: Experiment) -> tuple[EvaluationConfig, int]:
        """Return the evaluation's options, and the training seed of the weights.

        Raises:
            MissingWeightsError: Weights are missing.
            DatasetError: Weights were trained with different seeds.
        """
        policy = self._found(experiment)
        if learned_parts(policy.name):
            policy = replace(policy, device=self.device)
        seed = training_seed(weights_of(policy))
        config = EvaluationConfig(
            out=experiment.summary_path(self.out, seed).with_suffix(""),
            policy=policy,
            split=self.split,
            kinds=experiment.kinds,
            tasks=experiment.tasks,
            episodes=self.episodes,
            language=experiment.language,
            perturb_start=experiment.perturb_start,
        )
        return config, seed

    def run(
        self,
        experiment: Experiment,
        engine: Engine,
        advance: Callable[[int], None] = lambda count: None,
    ) -> Path:
        """Play missing episodes, and write the result with packed lines beside it.

        Args:
            experiment: Experiment to play.
            engine: Workers that run the jobs.
            advance: Called with the number of newly finished episodes.

        Returns:
            The file of the result.

        Raises:
            DatasetError: Weights are missing, or a file cannot be written.
        """
        config, seed = self.config(experiment)
        rows = evaluate(config, engine, advance)
        # Names of weights instead of their paths on this machine.
        about = read_json(config.out / ABOUT) | {"policy": experiment.policy.about()}
        command = self._command(experiment, seed)
        path = experiment.summary_path(self.out, seed)
        write_packed(packed_beside(path), rows)
        summarise(rows, about, command, experiment.name).write(path)
        return path

    def _found(self, experiment: Experiment) -> PolicySpec:
        """Return the policy with the paths or names of its weights."""
        policy, runs = experiment.policy, experiment.runs(SEEDS[0])
        own = AND.join(experiment.trainings(SEEDS[0]))
        checkpoint = checkpoint_of(policy.name)
        if checkpoint is not None:
            how = f"{own}; then --weights {runs} finds them."
            path = self._weights(checkpoint, _CHECKPOINT, how)
            return replace(policy, name=policy.name.removesuffix(checkpoint) + path)
        names = list(policy.parts)
        for part in learned_parts(policy.name):
            how = own or AND.join(TRAININGS[part].commands(runs, SEEDS[0]))
            names[names.index(part)] = self._weights(part, _FILE, how)
        return replace(policy, name="+".join(names))

    def _weights(self, name: str, file: str, how: str) -> str:
        """Return the name of published weights, or the folder of their run.

        Args:
            name: Name of the published weights, and of their run.
            file: File of the weights in the folder of the run.
            how: The command that makes them.
        """
        if self.weights is None and name in published_weights():
            return name
        where = "are not published"
        if self.weights is not None:
            path = self.weights / name / file
            if path.is_file():
                return str(path.parent)
            where = f"are not in {self.weights}"
        raise MissingWeightsError(
            f"The weights of {name} {where}. Make them with: {how}"
        )

    def _command(self, experiment: Experiment, seed: int) -> str:
        words = [f"lemma reproduce {experiment.name}"]
        if self.weights is not None:
            words.append(f"--weights {experiment.runs(seed)}")
        if self.device != Reproduction.device and learned_parts(experiment.policy.name):
            words.append(f"--device {self.device}")
        if self.split != Reproduction.split:
            words.append(f"--split {self.split}")
        if self.episodes is not None:
            words.append(f"--episodes {self.episodes}")
        return " ".join(words)


def commands(experiments: list[Experiment]) -> list[str]:
    """Return the command lines for data, training and evaluation, with every seed."""
    elsewhere = [one for one in experiments if one.training]
    here = [one for one in experiments if not one.training]
    lines = list(DATA_COMMANDS) if _needed(here) else []
    ablations = bool(here) and here[0].suite == ABLATIONS
    for seed in SEEDS[:1] if ablations else SEEDS:
        for training in _needed(here):
            if seed == SEEDS[0]:
                lines += _as_it_was(training.name)
            lines += training.commands(here[0].runs(seed), seed)
        for one in here:
            if learned_parts(one.policy.name):
                lines.append(f"lemma reproduce {one.name} --weights {one.runs(seed)}")
            elif seed == SEEDS[0]:
                lines.append(f"lemma reproduce {one.name}")
    for one in elsewhere:
        for part in learned_parts(one.policy.name):
            lines += _as_it_was(part)
        for seed in one.seeds:
            # One command may make the data, or the weights, of several of them.
            lines += [each for each in one.trainings(seed) if each not in lines]
            lines.append(f"lemma reproduce {one.name} --weights {one.runs(seed)}")
    return lines


def _as_it_was(name: str) -> list[str]:
    """Return a comment with the command of published weights, if it differs."""
    entry = published_weights().get(name)
    if entry is None or entry["ended"] == "steps":
        return []
    how = "ended by its time limit" if entry["ended"] else "how it ended is not known"
    if entry["steps"]:
        how += f" after {entry['steps']} steps"
    return [f"# The published weights of {name}: {entry['command']} ({how})"]


def _needed(experiments: list[Experiment]) -> list[Training]:
    """Return the trainings of experiments, each once."""
    parts = [part for one in experiments for part in learned_parts(one.policy.name)]
    return [TRAININGS[part] for part in dict.fromkeys(parts)]


@dataclass(frozen=True)
class Agreement:
    """Agreement of repeated episodes with published lines."""

    episodes: int
    differing: tuple[str, ...]
    """Text of the differences of each episode that differs."""
    farthest_m: float
    """Largest distance between poses [m]."""

    @property
    def ok(self) -> bool:
        """Whether all agree."""
        return not self.differing


def check_experiment(
    experiment: Experiment,
    results: Path,
    episodes: int,
    engine: Engine,
    device: str = DEVICES[0],
) -> Agreement:
    """Play some episodes with published weights, and compare with published lines.

    Args:
        experiment: The experiment.
        results: Folder of published results.
        episodes: Number of episodes of each task and kind of instruction.
        engine: Workers that run the jobs.
        device: Device of the models.

    Raises:
        DatasetError: There are no lines of the experiment, or its weights are missing.
    """
    path = lines_at(experiment.summary_path(results, SHIPPED))
    lines = {key_of(row): row for row in read_lines(path)}
    with temporary_folder() as folder:
        plan = Reproduction(out=folder, episodes=episodes, device=device)
        config, seed = plan.config(experiment)
        if seed != SHIPPED:
            raise DatasetError(f"Weights of {experiment.name} ship with seed {seed}.")
        tasks = tuple(t for t in config.tasks if t in {task for _, task, _ in lines})
        kinds = tuple(k for k in config.kinds if k in {kind for kind, _, _ in lines})
        rows = evaluate(replace(config, tasks=tasks, kinds=kinds), engine)
    return compared([(lines[key_of(row)], row) for row in rows if key_of(row) in lines])


def compared(pairs: Sequence[tuple[Row, Row]]) -> Agreement:
    """Compare published lines with those of repeated episodes.

    Args:
        pairs: Published line and new line of each episode.

    Raises:
        InvalidConfigError: There are no pairs.
    """
    if not pairs:
        raise InvalidConfigError("No episode that was played has a published line.")
    differing = tuple(
        f"{'/'.join(map(str, key_of(line)))}: {'; '.join(found)}"
        for line, now in pairs
        if (found := list(_differences(line, now)))
    )
    return Agreement(len(pairs), differing, max(_farthest(*pair) for pair in pairs))


def _differences(line: Row, now: Row) -> Iterator[str]:
    """Yield texts of the differences of an episode from its line."""
    judged = ("success", "failure", "progress")
    yield from _unequal(line, now, "", ("instruction", "team", *judged))
    yield from _unequal(line["lenient"], now["lenient"], "leniently, ", judged)
    before, after = _subtasks(line), _subtasks(now)
    if len(before) != len(after):
        yield f"{len(before)} sub-tasks, now {len(after)}"
    for number, (old, new) in enumerate(zip(before, after, strict=False), 1):
        where = f"sub-task {number}: "
        yield from _unequal(old, new, where, (*_SYMBOLS, "outcome"))
        posed, poses = old["grounded"], new["grounded"]
        if (posed is None) != (poses is None):
            yield f"{where}poses were {posed}, are {poses}"
        for end, (shift_m, turn_rad) in _shifts(old, new):
            if shift_m > TOLERANCE_M or turn_rad > TOLERANCE_RAD:
                moved = f"{1e3 * shift_m:.2f} mm and {turn_rad:.4f} rad"
                yield f"{where}its {end} moved by {moved}"


_SYMBOLS = ("robot", "primitive", "pick", "place")


def _unequal(old: Row, new: Row, where: str, names: Iterable[str]) -> Iterator[str]:
    for name in names:
        if old[name] != new[name]:
            yield f"{where}{name} was {old[name]}, is {new[name]}"


def _shifts(old: Row, new: Row) -> Iterator[tuple[str, tuple[float, float]]]:
    """Yield the changes of a sub-task's poses: end, position [m] and yaw [rad]."""
    if old["grounded"] and new["grounded"]:
        for end in ("pick", "place"):
            one, other = old["grounded"][end], new["grounded"][end]
            turn_rad = math.remainder(other[2] - one[2], 2 * math.pi)
            yield end, (math.dist(one[:2], other[:2]), abs(turn_rad))


def _subtasks(line: Row) -> list[Row]:
    return [*line["subtasks"], *line["lenient"]["subtasks"]]


def _farthest(line: Row, now: Row) -> float:
    pairs = zip(_subtasks(line), _subtasks(now), strict=False)
    shifts = (shift_m for pair in pairs for _, (shift_m, _) in _shifts(*pair))
    return max(shifts, default=0.0)
