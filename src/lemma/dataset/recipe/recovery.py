"""Recovery states: perturbed executions, labelled with the expert's decisions.

Executed sub-tasks are replayed, and are the memory of a policy. The expert's decisions
are the labels that it learns.
"""

from collections import Counter
from dataclasses import asdict, dataclass
from typing import Any

from lemma.core.seeding import stream
from lemma.dataset.recipe.reader import Recipe
from lemma.dataset.recipe.record import EpisodeRecorder, in_words
from lemma.dataset.recipe.schema import (
    PERTURB_KEYS,
    ExpertRecord,
    PerturbedRecord,
    perturbed_as,
)
from lemma.env.episode import Episode
from lemma.expert.disturbances import (
    KINDS,
    NONE,
    Mistake,
    Perturbation,
    Perturber,
)
from lemma.expert.expert import Expert, ExpertStep
from lemma.expert.symbolic_state import SymbolicState
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import GroundedSubTask, SubTask

MAX_STEPS = 30
"""Sub-tasks that an episode has at most, as those of the expert alone."""


def record_perturbed(instance: Instance, perturbation: Perturbation) -> PerturbedRecord:
    """Let the expert work on an instance while some of its sub-tasks go wrong.

    At each keyframe an expert without memory decides. The episode ends where it says
    ``stop``, where it has no plan, where it fails without a perturbation, and when the
    time is up.

    Args:
        instance: The problem.
        perturbation: How often, and which draw.

    Returns:
        The record; ``success`` says whether the expert managed in spite of it.
    """
    episode = Episode(instance)
    scene = episode.simulation.scene
    saboteur, keeper = Perturber(instance.scene), EpisodeRecorder(episode)
    expert: list[ExpertRecord | None] = []
    kinds: list[str] = []
    keeper.keep()
    for number in range(MAX_STEPS):
        subtask, grounded = Expert(scene, instance.goal).act()
        if grounded is None:
            solved = episode.progress == 1.0
            expert.append(_known(instance, subtask, None) if solved else None)
            break
        expert.append(_known(instance, subtask, grounded))
        rng = stream("perturb", instance.key, perturbation.seed, number)
        done = Mistake(NONE, subtask, grounded)
        if rng.random() < perturbation.probability:
            now = SymbolicState.observe(scene)
            done = saboteur.spoil(subtask, grounded, now, rng)
        start = episode.elapsed_s
        result = episode.execute(done.grounded)
        keeper.keep(ExpertStep(done.subtask, done.grounded, result, start))
        kinds.append(done.kind)
        if episode.is_over:
            break
        if done.kind == NONE and not result.ok:
            # The expert failed: no label.
            expert[-1] = None
            break
    expert += [None] * (len(kinds) + 1 - len(expert))
    episode.stop()
    columns = keeper.columns()
    columns["key"] += f"/perturbed-{perturbation.seed}"
    return PerturbedRecord(**columns, expert=tuple(expert), perturbation=tuple(kinds))


def described(perturbation: Perturbation | None) -> dict[str, str]:
    """Return the entries of a record for a perturbation; none without one."""
    if perturbation is None:
        return {}
    values = (f"{perturbation.probability:g}", str(perturbation.seed))
    return dict(zip(PERTURB_KEYS, values, strict=True))


def perturbation_of(about: dict[str, str]) -> Perturbation | None:
    """Return the perturbation that a record names; None if none."""
    if not perturbed_as(about):
        return None
    probability, seed = (about[name] for name in PERTURB_KEYS)
    return Perturbation(float(probability), int(seed))


@dataclass(frozen=True, slots=True)
class RecoveryFigures:
    """Figures of perturbed executions."""

    episodes: int
    solved: int
    """Episodes in which the goal was reached nevertheless."""
    subtasks: int
    """Sub-tasks that were executed."""
    mistakes: dict[str, int]
    """Those that were perturbed, by kind."""
    keyframes: int
    """Keyframes that have a label."""
    after: int
    """Those of them that come after a mistake."""
    unlabelled: int
    """Keyframes without a label: no plan, a failure of the expert, no time."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON."""
        return asdict(self)


def recovery_figures(recipe: Recipe) -> RecoveryFigures:
    """Count what is in a recipe of perturbed executions, or in a part of one.

    Args:
        recipe: Its states are not read.
    """
    rows = list(recipe.rows("success", "expert", "perturbation"))
    kinds = Counter(kind for row in rows for kind in row["perturbation"])
    labelled = [[*row["expert"], None].index(None) for row in rows]
    calm = [
        min(count, next((i for i, k in enumerate(kinds_) if k != NONE), count) + 1)
        for count, kinds_ in zip(
            labelled, (row["perturbation"] for row in rows), strict=True
        )
    ]
    return RecoveryFigures(
        episodes=len(rows),
        solved=sum(row["success"] for row in rows),
        subtasks=kinds.total(),
        mistakes={kind: kinds[kind] for kind in KINDS},
        keyframes=sum(labelled),
        after=sum(labelled) - sum(calm),
        unlabelled=sum(len(row["expert"]) for row in rows) - sum(labelled),
    )


def _known(
    instance: Instance, subtask: SubTask, grounded: GroundedSubTask | None
) -> ExpertRecord:
    pick = place = None
    if grounded is not None:
        pick, place = (
            (pose.x, pose.y, pose.yaw) for pose in (grounded.pick, grounded.place)
        )
    return ExpertRecord(
        robot=subtask.robot,
        primitive=str(subtask.primitive),
        pick=subtask.pick,
        place=subtask.place,
        instruction=in_words(instance, subtask),
        pick_pose=pick,
        place_pose=place,
    )
