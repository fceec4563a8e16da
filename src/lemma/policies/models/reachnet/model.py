"""ReachNet: perception of entities and reach, planning and grounding with both.

Perception converts the map to a small scene table: poses of entities, and the radii of
each robot's reach. The reader converts the instruction to (top, bottom) pairs. The
planner scores all sub-tasks with the estimated reach. The grounder derives poses from
the entities' poses. These three have no pixels as input, so they also train on labels
with noise.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any, ClassVar, Literal

import torch
from torch import Tensor
from torch.nn import functional as F

from lemma.core.arguments import Cost, Depth
from lemma.core.errors import InvalidConfigError
from lemma.core.poses import Pose2
from lemma.policies.batch import STOP, Batch, Labels
from lemma.policies.entities import EntitySet
from lemma.policies.interfaces import Decision, Insight, PolicyInput, Understanding
from lemma.policies.layers import constant
from lemma.policies.models.base import MODELS, MapConfig, MapModel, subtask_of
from lemma.policies.models.reachnet.goal_reader import GoalReader, ReaderConfig
from lemma.policies.models.reachnet.grounder import (
    ReachNetGrounder,
    demonstrated_reach,
    reach_loss,
    score_decisions,
    score_perception,
)
from lemma.policies.models.reachnet.memory import Memory, Sighting
from lemma.policies.models.reachnet.noise import Noise, disturbed
from lemma.policies.models.reachnet.perception import Perception, PerceptionConfig
from lemma.policies.models.reachnet.planner import (
    PlannerConfig,
    ReachNetPlanner,
    decision_of,
    number_of,
    numbers_of,
)
from lemma.policies.models.reachnet.scene_table import (
    SceneTable,
    needed_entities,
    numbered,
    true_radii,
    true_table,
    turned,
    turned_numbers,
)
from lemma.policies.models.reachnet.understanding import (
    WHY,
    goal_numbers,
    lessons_of,
    pairs_of,
    reader_tensors,
    understood,
)
from lemma.policies.text.encoder import Sentences
from lemma.policies.text.lessons import Lessons
from lemma.tasks.subtask import GroundedSubTask, Primitive, SubTask

_REACH_POINTS = 128
_NEVER = 1e4
_LOUDEST = 25.0
_OPTIONS = 6


@dataclass(frozen=True)
class ReachNetConfig(MapConfig):
    """Options of ReachNet."""

    reach: Literal["simulator", "demonstrations", "none"] = "simulator"
    """Source of supervision for the reach: labels of the simulator, the robots' actions
    in demonstrations, or none."""
    robots: Depth = 2
    """Number of robots of a team."""
    entities: tuple[str, ...] = ()
    """Names of its entities; all registered ones if empty."""
    eye: PerceptionConfig = field(default_factory=PerceptionConfig)
    """Options of perception."""
    reader: ReaderConfig = field(default_factory=ReaderConfig)
    """Options of the reader."""
    planner: PlannerConfig = field(default_factory=PlannerConfig)
    """Options of the planner."""
    noise: Noise = field(default_factory=Noise)
    """Noise of scene tables from labels."""
    draws: Depth = 2
    """Number of scene tables from the labels of each frame; half of them are turned."""
    perceived: bool = True
    """Whether the planner also trains on the results of perception."""
    failure_cost: Cost = 4.0
    """Decrease of a sub-task's log-probability for each failure in a row."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        if self.draws < 1 or self.robots < 2:
            raise InvalidConfigError(
                f"draws={self.draws} and robots={self.robots}. Valid: one or more "
                "draws, and two or more robots."
            )


class ReachNet(MapModel):
    """A policy that plans and grounds from maps, joints and an instruction."""

    selection = "decision"
    former_names: ClassVar[Mapping[str, str]] = {
        r"^eye\.(stem|down|lift|up)\.": r"eye.trunk.\1.",
        r"^(planner\.layers\.\d+\.hidden)\.0\.": r"\1_in.",
        r"^(planner\.layers\.\d+\.hidden)\.2\.": r"\1_out.",
    }
    former_options: ClassVar[Mapping[str, Any]] = {"reader": {"refuses": False}}
    reads_outcomes = True
    of_fixed_shape = True

    def __init__(self, config: ReachNetConfig | None = None) -> None:
        """Make the weights.

        Args:
            config: Options; the defaults if None.
        """
        super().__init__()
        config = config or ReachNetConfig()
        named = EntitySet.of(config.entities)
        self.config = config = replace(config, entities=named.names)
        known = config.reach != "none"
        self.eye = Perception(config.eye, config.robots, named)
        self.reader = GoalReader(config.reader, named)
        self.planner = ReachNetPlanner(config.planner, config.robots, known)
        self.grounding = ReachNetGrounder(known)
        self._memory = Memory()

    def text_tensors(self, batch: Batch) -> dict[str, Tensor]:
        """Return the goals and the words of the instructions as numbers."""
        return reader_tensors(self.reader, batch, self.device)

    def lessons(self, frames: int) -> Lessons | None:
        """Return the draws of sentences for the reader alone."""
        return lessons_of(self.config.reader, self.entities, frames)

    def loss(self, batch: Batch) -> dict[str, Tensor]:
        """Return the terms of the loss."""
        labels = batch.labels
        assert labels is not None
        marks, coarse = self.eye(batch)
        tensors = batch.text_tensors or self.text_tensors(batch)
        words = Sentences(*tensors["words"])
        reading = self.reader.loss(words, tensors["goal"], tensors["reasons"])
        goal = tensors["goal"][: len(batch)]
        with torch.autocast(self.device.type, enabled=False):
            seen_radii = self.eye.reach(coarse, batch, labels.bases[..., :2])
            known = self._true_radii(labels)
            radii = seen_radii if known is None else known
            truth = true_table(labels, radii, batch.raster, batch.entities)
            seen = true_table(labels, seen_radii, batch.raster, batch.entities)
            terms = self.eye.losses(marks, truth, batch)
            terms["reading"] = reading
            terms["reach"] = self._reach_loss(seen, known, labels, batch)
            found = None
            if self.config.perceived:
                with torch.no_grad():
                    found = self.eye.table(marks, coarse, batch)
            return terms | self._table_losses(truth, found, goal, batch)

    def _true_radii(self, labels: Labels) -> Tensor | None:
        """Return the true radii, if the option ``reach`` allows them."""
        if self.config.reach != "simulator":
            return None
        return true_radii(labels.arms, self.device)

    def _reach_loss(
        self, seen: SceneTable, known: Tensor | None, labels: Labels, batch: Batch
    ) -> Tensor:
        if self.config.reach == "none":
            # Distributed training requires a gradient for every weight.
            unused = (self.planner.reach_sharpness, self.planner.reach_weight)
            return 0.0 * (seen.radii.sum() + sum(unused))
        if known is None:
            return demonstrated_reach(seen, labels)
        sides = constant((batch.raster.columns, batch.raster.rows), self.device)
        half = sides * (batch.raster.cell_m / 2)
        share = torch.rand(len(batch), _REACH_POINTS, 2, device=self.device) * 2 - 1
        return reach_loss(seen, known, seen.bases, share * half)

    def _table_losses(
        self, truth: SceneTable, seen: SceneTable | None, goal: Tensor, batch: Batch
    ) -> dict[str, Tensor]:
        """Return the losses of planner and grounder.

        Args:
            truth: True scenes.
            seen: Results of perception, on which the planner trains, too; or None.
            goal: Goals, (B, conjuncts, 2).
            batch: Batch with labels.
        """
        labels = batch.labels
        assert labels is not None
        decision, past, config = labels.decision, batch.past, self.config
        needed = needed_entities(decision, goal, len(batch.entities))
        draws = [disturbed(truth, config.noise, needed) for _ in range(config.draws)]
        pasts, wanted = [past] * config.draws, [decision] * config.draws
        for i in range(1, config.draws, 2):
            draws[i] = turned(draws[i])
            pasts[i] = turned_numbers(past, config.robots)
            wanted[i] = turned_numbers(decision, config.robots)
        counts = [torch.ones_like(decision[:, 0], dtype=torch.bool)] * config.draws
        if seen is not None:
            draws.append(seen)
            pasts.append(past)
            wanted.append(decision)
            # Only frames in which the entities of the sub-task are seen.
            moved = numbered(decision[:, 2:], len(batch.entities))
            counts.append((seen.present | ~moved).all(1))
        scores = self.planner(
            SceneTable.joined(draws),
            goal.repeat(len(draws), 1, 1),
            torch.cat(pasts),
            self.grounding.drags,
        )
        number = number_of(torch.cat(wanted), config.robots, batch.entities)
        wrong = F.cross_entropy(scores, number, reduction="none").clamp(max=_LOUDEST)
        able = torch.cat(counts)
        plan = torch.where(able, wrong, 0.0).sum() / able.sum().clamp(min=1)
        grounding = self.grounding.losses(
            draws[0], decision, labels.pick_pose, labels.place_pose
        )
        return {"plan": plan, **grounding}

    def score(self, batch: Batch) -> dict[str, Tensor]:
        """Return scores of decisions, (B,) each; ``decision`` is symbols and poses."""
        labels = batch.labels
        assert labels is not None
        with self.deciding():
            table, decision, _ = self._decide(batch, self._sighting(batch))
            with torch.autocast(self.device.type, enabled=False):
                poses = self.grounding(table, decision)
                demonstrated = self.grounding(table, labels.decision)
                goal = goal_numbers(labels.goals, self.device, batch.entities)
                read, _ = self.reader.read(batch.instructions, table.present)
                # The order of the two pairs does not matter.
                orders = torch.stack([goal, goal.flip(1)])
                right = (orders == read).flatten(2).all(2).any(0)
                known = self._true_radii(labels)
            radii = table.radii if known is None else known
            truth = true_table(labels, radii, batch.raster, batch.entities)
            return {
                **score_decisions(
                    decision, poses, demonstrated, labels, batch.entities
                ),
                "reading": right.float(),
                **score_perception(table, truth, batch.raster),
            }

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        """Return the next sub-task of each episode."""
        with self.deciding():
            return [
                subtask_of(row, batch.entities)
                for batch, seen, failed in self._given(inputs)
                for row in self._decide(batch, seen, failed)[1].tolist()
            ]

    def ground(
        self, inputs: Sequence[PolicyInput], subtasks: Sequence[SubTask]
    ) -> list[GroundedSubTask | None]:
        """Return each sub-task with poses; None if an entity is not seen."""
        found: list[GroundedSubTask | None] = []
        robots, entities = self.config.robots, self.entities
        numbers = [numbers_of(subtask, robots, entities) for subtask in subtasks]
        with self.deciding():
            for batch, seen, _ in self._given(inputs):
                rows = numbers[len(found) : len(found) + len(batch)]
                decision = torch.tensor(rows, device=self.device)
                table = seen.table_with(decision[:, 2:])
                found += self._grounded(table, decision)
        return found

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        """Return the next decision of each episode."""
        found: list[Decision] = []
        with self.deciding():
            for batch, seen, failed in self._given(inputs):
                table, decision, reasons = self._decide(batch, seen, failed)
                grounded = self._grounded(table, decision)
                rows = zip(decision.tolist(), grounded, reasons.tolist(), strict=True)
                for row, poses, reason in rows:
                    subtask = subtask_of(row, batch.entities)
                    ok = poses or subtask.primitive is Primitive.STOP
                    why = (
                        "" if ok else f"Objects that it needs are not seen: {subtask}."
                    )
                    if reason >= 0:
                        why = WHY[reason]
                    found.append(Decision(subtask, poses, why))
        return found

    def understand(self, inputs: Sequence[PolicyInput]) -> list[Understanding]:
        """Return the interpretation of each instruction in its scene."""
        found: list[Understanding] = []
        with self.deciding():
            for batch, seen, _ in self._given(inputs):
                read = self.reader.weigh(batch.instructions, seen.noticed)
                names, refuses = batch.entities.places, self.config.reader.refuses
                found += understood(read, names, refuses=refuses)
        return found

    def explain(self, inputs: Sequence[PolicyInput]) -> list[Insight]:
        """Return perception, goal and most likely sub-tasks for each decision."""
        found: list[Insight] = []
        with self.deciding():
            for batch, seen, failed in self._given(inputs):
                table, goals, scores, _ = self._weigh(batch, seen, failed)
                shares, numbers = scores.float().softmax(-1).topk(_OPTIONS)
                options = decision_of(numbers, self.config.robots, batch.entities)
                for row, rows in enumerate(goals.tolist()):
                    goal = pairs_of(rows, batch.entities.places)
                    likely = zip(
                        (subtask_of(o, batch.entities) for o in options[row].tolist()),
                        shares[row].tolist(),
                        strict=True,
                    )
                    found.append(Insight(*table.seen(row), goal, tuple(likely)))
        return found

    def _given(
        self, inputs: Sequence[PolicyInput]
    ) -> Iterator[tuple[Batch, Sighting, list[list[SubTask]]]]:
        """Yield batches, what is seen, and sub-tasks that failed since a success."""
        memory = self._memory.valid(self.eye)
        memory.look(inputs, lambda new: map(self._sighting, self.batches(new)))
        left = iter(inputs)
        for batch in self.batches(inputs):
            part = [*islice(left, len(batch))]
            seen = Sighting.joined([memory.recall(one) for one in part])
            yield batch, seen, [one.failed for one in part]

    def _sighting(self, batch: Batch) -> Sighting:
        marks, coarse = self.eye(batch)
        with torch.autocast(self.device.type, enabled=False):
            return self.eye.sighting(marks, coarse, batch)

    def _decide(
        self,
        batch: Batch,
        seen: Sighting,
        failed: Sequence[Sequence[SubTask]] = (),
    ) -> tuple[SceneTable, Tensor, Tensor]:
        """Return scenes, the most likely sub-tasks, (B, 4), and reasons, (B,)."""
        table, _, scores, reasons = self._weigh(batch, seen, failed)
        robots = self.config.robots
        return table, decision_of(scores.argmax(-1), robots, batch.entities), reasons

    def _weigh(
        self, batch: Batch, seen: Sighting, failed: Sequence[Sequence[SubTask]]
    ) -> tuple[SceneTable, Tensor, Tensor, Tensor]:
        """Return scenes, goals, scores of all sub-tasks, and refusals.

        Returns:
            The scenes; the goals, (B, conjuncts, 2); scores, (B, N); and the index of
            the reason for refusal, (B,), -1 for an order. After a refusal only ``stop``
            is possible.
        """
        goal, reasons = self.reader.read(batch.instructions, seen.noticed)
        with torch.autocast(self.device.type, enabled=False):
            table = seen.table_with(goal.flatten(1))
            scores = self.planner(table, goal, batch.past, self.grounding.drags)
        robots = self.config.robots
        for row, subtasks in enumerate(failed):
            for subtask in subtasks:
                numbers = torch.tensor([numbers_of(subtask, robots, batch.entities)])
                number = int(number_of(numbers, robots, batch.entities))
                scores[row, number] -= self.config.failure_cost
        # ``stop`` is the last sub-task.
        scores[reasons >= 0, :-1] -= _NEVER
        return table, goal, scores, reasons

    def _grounded(
        self, table: SceneTable, decision: Tensor
    ) -> list[GroundedSubTask | None]:
        found: list[GroundedSubTask | None] = []
        rows = (part.tolist() for part in (decision, *self.grounding(table, decision)))
        for numbers, *ends in zip(*rows, strict=True):
            poses = None
            if numbers[1] != STOP and all(map(math.isfinite, (*ends[0], *ends[1]))):
                subtask = subtask_of(numbers, table.entities)
                start, end = (Pose2(*pose) for pose in ends)
                poses = GroundedSubTask(subtask.robot, subtask.primitive, start, end)
            found.append(poses)
        return found


MODELS.add("reachnet", (ReachNet, ReachNetConfig))
