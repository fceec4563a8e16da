"""The configuration of an evaluation: policy, episodes and instructions."""

import shlex
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from lemma.core.arguments import known, whole
from lemma.core.errors import InvalidConfigError
from lemma.core.plugins import plugin_words
from lemma.dataset.recipe.files import versions
from lemma.evaluation.protocol.disturbances import DISTURBANCES
from lemma.evaluation.protocol.expert_times import TIMED_SPLITS
from lemma.evaluation.protocol.language_controls import FULL, LANGUAGES
from lemma.evaluation.protocol.rules import GROUP, quote
from lemma.evaluation.protocol.suites import quote_suites
from lemma.evaluation.records import PROTOCOL_VERSION
from lemma.evaluation.run.loading import check_device, served_parts, weights_of
from lemma.evaluation.run.rollout import Rollout
from lemma.policies.interfaces import TIMEOUT_S
from lemma.policies.spec import ACTINGS, DEVICES, PLANNINGS, PolicySpec
from lemma.tasks.instance import (
    BENCHMARK_VERSION,
    OWN_SPLIT,
    Instance,
    splits_of,
)
from lemma.tasks.language.blind import check_kind, instruction
from lemma.tasks.names import SUITES
from lemma.tasks.suite import FREE_SPLIT, SUITE, TASKS, check_split
from lemma.tasks.teams.pairs import PAIRS, TEST_PAIRS


def acting_by_default(tasks: Iterable[str], *, controls: bool = False) -> str:
    """Return the default way of acting in some tasks, one of ``ACTINGS``.

    It is together in tasks of the suite ``teams``, and in turns in all others and for
    policies at control level, as in published results.

    Args:
        tasks: Names of the tasks.
        controls: Whether the policy is at control level.
    """
    together = set(tasks) <= set(SUITES["teams"]) and not controls
    return ACTINGS[together]


VERDICTS = ("both", "strict")
"""Verdicts of an evaluation: both, or the strict one alone."""


@dataclass(frozen=True, kw_only=True)
class EvaluationConfig:
    """Options of an evaluation."""

    out: Path
    """Folder of the result."""
    policy: PolicySpec
    tasks: tuple[str, ...] = SUITE
    """Names of tasks, including your own."""
    split: str = "test"
    """Frozen list of instances; or ``"free"``, which samples them with seeds from 0."""
    kinds: tuple[str, ...] = ("high_level",)
    """Kinds of instructions."""
    episodes: int | None = None
    """Number of episodes of every task, the first ones; all if None. Split ``"free"``
    needs it."""
    language: str = FULL
    """The language control, one of
    :data:`lemma.evaluation.protocol.language_controls.LANGUAGES`."""
    perturb_start: bool = False
    """Whether episodes begin at perturbed starts, see
    :mod:`lemma.evaluation.protocol.perturbed_starts`."""
    disturb: str = ""
    """Disturbance of the robots, one of :data:`.DISTURBANCES`; empty for none."""
    verdicts: str = VERDICTS[0]
    """One of :data:`VERDICTS`. With the strict verdict alone, an episode ends at a
    protective stop."""
    instance: Instance | None = None
    """The only instance to play; then ``tasks`` and ``split`` are its task and
    :data:`OWN_SPLIT`."""

    def __post_init__(self) -> None:
        """Check the names and the number."""
        check_device(self.policy)
        self._check_acting()
        if self.instance is not None:
            self._check_own(self.instance)
            self._check_disturbance()
            return
        if not (self.tasks and self.kinds):
            raise InvalidConfigError(
                "There are no episodes. Name a task and a kind of instruction."
            )
        for task in self.tasks:
            check_split(task, self.split)
            self._check_pairs()
            for kind in self.kinds:
                check_kind(kind, task, self.split)
        known("control of language", self.language, LANGUAGES)
        known("protocol", self.verdicts, VERDICTS)
        self._check_disturbance()
        if self.perturb_start and self.split not in TIMED_SPLITS:
            raise InvalidConfigError(
                f"Split {self.split!r} has no perturbed starts; "
                f"{' and '.join(TIMED_SPLITS)} have."
            )
        if self.episodes is not None:
            whole("episodes", self.episodes, 1)
        elif self.split == FREE_SPLIT:
            raise InvalidConfigError(
                f"Split {FREE_SPLIT!r} is sampled without a limit. Set the number of "
                "episodes of each task with --episodes."
            )

    def _check_acting(self) -> None:
        if self.policy.controls or self.policy.together:
            return
        if self.instance is not None:
            self.instance.goal.check_in_turns()
            return
        for task in self.tasks:
            TASKS[task].check_in_turns()

    def _check_pairs(self) -> None:
        if self.split == PAIRS and self.language != FULL:
            raise InvalidConfigError(
                f"Split {PAIRS!r} asks whether a team can do what its sentence says. "
                "Give it the full sentence."
            )

    def _check_disturbance(self) -> None:
        if not self.disturb:
            return
        known("disturbance", self.disturb, DISTURBANCES)
        if self.policy.controls:
            raise InvalidConfigError(
                "A policy with motor commands sets the speed of the arms itself, so it "
                "has no disturbances. Leave out the disturbance."
            )

    def _check_own(self, instance: Instance) -> None:
        alone = (self.tasks, self.split) == ((instance.task,), OWN_SPLIT)
        of_lists = self.episodes or self.perturb_start or self.language == "shuffled"
        if of_lists or not alone:
            raise InvalidConfigError(
                "An instance of your own is the only episode. Leave out tasks, split, "
                "number of episodes, perturbation and shuffling."
            )
        for kind in self.kinds:
            instruction(instance, kind)

    def count(self, task: str) -> int:
        """Return the number of episodes of a task per kind of instruction."""
        if self.instance is not None:
            return 1
        every = splits_of(task).get(self.split, self.episodes or 0)
        if self.split == PAIRS:
            every = 2 * TEST_PAIRS
        return every if self.episodes is None else min(self.episodes, every)

    @property
    def total(self) -> int:
        """Total number of episodes."""
        return len(self.kinds) * sum(map(self.count, self.tasks))

    def about(self) -> dict[str, Any]:
        """Return the settings that determine the result, as in ``about.json``."""
        planners = [
            getattr(planner, "about", None) for planner in self.policy.planners()
        ]
        suites = quote_suites(self.tasks) if self.instance is None else {}
        device = self.policy.device
        return {
            "policy": self.policy.about(),
            **({"planners": planners} if any(planners) else {}),
            "oracle": self.policy.oracle,
            **({"device": device} if device != DEVICES[0] else {}),
            "weights": weights_of(self.policy),
            "served": served_parts(self.policy),
            "language": self.language,
            "perturb_start": self.perturb_start,
            **({"disturb": self.disturb} if self.disturb else {}),
            "split": self.split,
            "protocol": quote(),
            **({"suites": suites} if suites else {}),
            "protocol_version": PROTOCOL_VERSION,
            "verdicts": self.verdicts,
            **({"instance": self.instance.to_dict()} if self.instance else {}),
            "horizon_s": Rollout.horizon_s,
            **versions(BENCHMARK_VERSION),
        }

    @property
    def _usual(self) -> str:
        return acting_by_default(self.tasks, controls=self.policy.controls)

    def command(self) -> str:
        """Return the equivalent command line.

        Files have their names without folders, so that the same result has the same
        command on every machine.
        """
        policy = self.policy
        kinds = ",".join(kind.replace("_", "-") for kind in self.kinds)
        arguments = [f"{name}={value}" for name, value in policy.arguments]
        own, pairs = self.instance is not None, self.split == PAIRS
        wanted = (
            ("--pairs", "", pairs),
            ("--split", self.split, not own and not pairs),
            ("--instance", "FILE.json", own),
            (
                "--tasks",
                ",".join(self.tasks),
                not own and not pairs and self.tasks != SUITE,
            ),
            ("--episodes", str(self.episodes), self.episodes is not None),
            ("--level", policy.level, bool(policy.level)),
            ("--policy-args", ",".join(arguments), bool(arguments)),
            ("--planning", policy.planning, policy.planning != PLANNINGS[0]),
            ("--gta", "", policy.gta),
            ("--acting", policy.acting, policy.acting != self._usual),
            ("--adapter", policy.adapter, bool(policy.adapter)),
            ("--device", policy.device, policy.device != DEVICES[0]),
            ("--timeout", f"{policy.timeout_s:g}", policy.timeout_s != TIMEOUT_S),
            ("--language", self.language, self.language != FULL),
        )
        words = ["lemma", "evaluate", *plugin_words(), "--policy", policy.name]
        words += ["--instructions", kinds]
        for name, value, is_wanted in wanted:
            if is_wanted:
                words += [name, value] if value else [name]
        # These words are already quoted for the shell.
        asked = policy.chat.words() if policy.chat is not None else []
        asked += ["--perturb-start"] * self.perturb_start
        asked += ["--disturb", self.disturb] * bool(self.disturb)
        asked += ["--protocol", self.verdicts] * (self.verdicts != VERDICTS[0])
        return " ".join([shlex.join(words), *asked])

    def groups(self) -> Iterator[tuple[str, str, range]]:
        """Yield kind, task and numbers of the episodes that are played together."""
        first = self.instance.index if self.instance else 0
        for kind, task in product(self.kinds, self.tasks):
            last = first + self.count(task)
            for start in range(first, last, GROUP):
                yield kind, task, range(start, min(start + GROUP, last))
