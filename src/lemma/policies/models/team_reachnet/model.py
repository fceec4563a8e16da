"""Team ReachNet: one network for teams of two to four robots, which plans together.

It looks at the table when all arms are at rest, and reads the sentence. From the scene
that it sees, it plans all moves until ``stop``, one after another, each in the scene
that the moves before it will leave behind. Every robot then gets its own moves of the
plan, as soon as those on which they depend have been ordered. After a failure it waits
until all arms are at rest, looks again, and orders one move at a time.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor
from torch.nn import functional as F

from lemma.core.arguments import Cost, Depth
from lemma.env.view import View
from lemma.policies.batch import NOBODY, Batch, Labels
from lemma.policies.entities import EntitySet
from lemma.policies.interfaces import Decision, PolicyInput
from lemma.policies.layers import sent
from lemma.policies.models.base import MODELS, MapConfig, MapModel
from lemma.policies.models.reachnet.goal_reader import ReaderConfig
from lemma.policies.models.reachnet.marks import Marks
from lemma.policies.models.reachnet.noise import Noise
from lemma.policies.models.reachnet.perception import PerceptionConfig
from lemma.policies.models.reachnet.scene_table import true_radii
from lemma.policies.models.reachnet.scene_table import true_table as true_scene
from lemma.policies.models.team_reachnet.orders import next_orders
from lemma.policies.models.team_reachnet.perception import TeamPerception
from lemma.policies.models.team_reachnet.planner import (
    TeamPlanner,
    TeamPlannerConfig,
    move_of,
    number_of,
)
from lemma.policies.models.team_reachnet.reader import (
    RULES,
    Reading,
    TeamReader,
    Wanted,
    named_entities,
    rule_of_times,
    wanted_of,
)
from lemma.policies.models.team_reachnet.table import (
    TeamTable,
    recalled,
    remembered,
    true_table,
)
from lemma.policies.models.team_reachnet.teams import (
    REGIONS,
    ROBOTS,
    colored,
    distinct,
    move_named,
    move_numbers,
    named_colors,
    numbers_by_color,
    numbers_of,
    weak_hands,
)
from lemma.policies.models.view_cache import ViewCache
from lemma.policies.text.encoder import Sentences
from lemma.policies.together.interfaces import Orders, TeamInput
from lemma.tasks.subtask import STOP, Primitive, SubTask
from lemma.tasks.teams.rule import Rule, Together

_LOUDEST = 25.0
_LONGEST = 16
"""Largest number of moves in a plan."""
_MOST_FAILURES = 6
_SUCCESS = "success"
_UNSEEN = -6.0
"""Change of the logit of a pair that is read but not seen."""


@dataclass(frozen=True)
class TeamReachNetConfig(MapConfig):
    """Options of the team's ReachNet."""

    entities: tuple[str, ...] = ()
    """Names of its entities; all registered ones if empty."""
    eye: PerceptionConfig = field(default_factory=PerceptionConfig)
    """Options of perception."""
    reader: ReaderConfig = field(default_factory=lambda: ReaderConfig(refuses=False))
    """Options of the reader; it cannot refuse."""
    planner: TeamPlannerConfig = field(default_factory=TeamPlannerConfig)
    """Options of the planner."""
    noise: Noise = field(default_factory=Noise)
    """Noise of scenes from labels."""
    draws: Depth = 3
    """Number of scenes from the labels of each frame, each turned by any angle."""
    failure_cost: Cost = 4.0
    """Decrease of a move's log-probability for each failure since the last success."""


class TeamReachNet(MapModel):
    """Plans moves of cubes for a team, from a map, joints and an instruction."""

    selection = "decision"
    reads_outcomes = True
    of_fixed_shape = True
    of_any_team = True
    reads_places = True
    symbolic = True

    def __init__(self, config: TeamReachNetConfig | None = None) -> None:
        """Make the weights.

        Args:
            config: Options; the defaults if None.
        """
        super().__init__()
        config = config or TeamReachNetConfig()
        named = EntitySet.of(config.entities)
        self.config = replace(config, entities=named.names)
        self.eye = TeamPerception(config.eye, named)
        self.reader = TeamReader(config.reader, named)
        self.planner = TeamPlanner(config.planner)
        self._views: ViewCache[tuple[Marks, Tensor, Batch]] = ViewCache()

    @property
    def entities(self) -> EntitySet:
        """Its entities, and the regions of all pairs."""
        return EntitySet(self.config.entities, REGIONS)

    def text_tensors(self, batch: Batch) -> dict[str, Tensor]:
        """Return words, goals, moves and teams as numbers."""
        labels, device = batch.labels, self.device
        assert labels is not None
        teams = [distinct(colors) for colors in labels.robot_colors]
        entities = batch.entities
        wanted = wanted_of(labels.goals, labels.rules, teams, entities, device)
        words = self.reader.sentences.read(batch.instructions, device)
        moves = [
            move_numbers(decision, team, entities)
            for decision, team in zip(labels.decision.tolist(), teams, strict=True)
        ]
        return {
            "words": torch.stack(words),
            **{f"wanted_{name}": tensor for name, tensor in wanted._asdict().items()},
            "move": sent(torch.tensor(moves), device),
            "robot": numbers_by_color(teams, device),
            "color": named_colors(labels.robot_colors, device),
            "weak": weak_hands(labels.hands, teams, device),
        }

    def loss(self, batch: Batch) -> dict[str, Tensor]:
        """Return the terms of the loss."""
        tensors = batch.text_tensors or self.text_tensors(batch)
        batch, labels = colored(batch, tensors["robot"])
        assert labels is not None
        marks, coarse = self.eye(batch)
        wanted = Wanted(*(tensors[f"wanted_{name}"] for name in Wanted._fields))
        team, weak = tensors["robot"] >= 0, tensors["weak"]
        with torch.autocast(self.device.type, enabled=False):
            seen = self.eye.reach(coarse, batch, labels.bases[..., :2])
            known = torch.where(
                team[..., None], true_radii(labels.arms, self.device), seen.detach()
            )
            scene = true_scene(labels, seen, batch.raster, batch.entities)
            terms = self.eye.losses(marks, scene, batch)
            terms["reach"] = self.eye.reaches(scene, known, batch)
            truth = true_table(labels, known, team, weak, batch.entities)
            terms["heavy"] = self.eye.weight_loss(
                marks, truth.there, truth.xy, labels.heavy, batch
            )
            with torch.no_grad():
                found = self.eye.look(marks, coarse, batch, team, weak)
                perceived = remembered(found, truth)
        at_rest = _at_rest(wanted, labels)
        read = self.reader.understand(
            Sentences(*tensors["words"]), truth, tensors["color"]
        )
        terms |= self.reader.reading_loss(read, wanted)
        with torch.autocast(self.device.type, enabled=False):
            terms["plan"] = self._plan_loss(
                truth, perceived, read, wanted, tensors["move"], at_rest
            )
        return terms

    def _plan_loss(
        self,
        truth: TeamTable,
        seen: TeamTable,
        read: Reading,
        wanted: Wanted,
        move: Tensor,
        at_rest: Tensor,
    ) -> Tensor:
        """Return the planner's loss in noisy true scenes and in perceived ones."""
        said = wanted.shares(truth.entities.stick)
        drawn = []
        for _ in range(self.config.draws):
            angle = torch.rand(len(truth), device=self.device) * 2 * torch.pi
            drawn.append(truth.turned(angle).disturbed(self.config.noise))
        tables = seen
        for one in drawn:
            tables = tables.joined(one)
        shares = [Reading(*(part.detach() for part in read.shares()))]
        shares += [said] * self.config.draws
        goals = Reading(*(torch.cat(parts) for parts in zip(*shares, strict=True)))
        scores = self.planner(tables, goals)
        cargo, targets = truth.entities.cargo, truth.entities.stick
        number = number_of(move, cargo, targets)
        wrong = F.cross_entropy(
            scores, number.repeat(1 + self.config.draws), reduction="none"
        ).clamp(max=_LOUDEST)
        # Only perceived frames in which the entities of the move are seen.
        named = move[:, 1:].clamp(0, len(truth.entities) - 1)
        asked = (move[:, 1:] >= 0) & (move[:, 1:] < len(truth.entities))
        counts = (seen.there.gather(1, named) | ~asked).all(1)
        able = torch.cat([counts, *[torch.ones_like(counts)] * self.config.draws])
        able &= at_rest.repeat(1 + self.config.draws)
        return torch.where(able, wrong, 0.0).sum() / able.sum().clamp(min=1)

    def score(self, batch: Batch) -> dict[str, Tensor]:
        """Return scores of decisions and readings, (B,) each."""
        tensors = self.text_tensors(batch)
        batch, labels = colored(batch, tensors["robot"])
        assert labels is not None
        wanted = Wanted(*(tensors[f"wanted_{name}"] for name in Wanted._fields))
        with self.deciding(), torch.autocast(self.device.type, enabled=False):
            team, weak = tensors["robot"] >= 0, tensors["weak"]
            radii = true_radii(labels.arms, self.device)
            truth = true_table(labels, radii, team, weak, batch.entities)
            read = self.reader.understand(
                Sentences(*tensors["words"]), truth, tensors["color"]
            )
            marks, coarse = self.eye(batch)
            found = self.eye.look(marks, coarse, batch, team, weak)
            seen = remembered(found, truth)
            cargo, targets = truth.entities.cargo, truth.entities.stick
            number = number_of(tensors["move"], cargo, targets)
            shares = read.decided()
            chosen = self.planner(seen, shares).argmax(1)
            told = self.planner(truth, wanted.shares(targets)).argmax(1)
            bottoms = shares.bottoms.argmax(-1)
            bottoms = torch.where(bottoms == targets, NOBODY, bottoms)
            right = (bottoms == wanted.bottoms).all(1)
            at_rest = _at_rest(wanted, labels)
            return {
                "decision": torch.where(at_rest, (chosen == number).float(), torch.nan),
                "planned": torch.where(at_rest, (told == number).float(), torch.nan),
                "reading": right.float(),
                "rule": (shares.rule.argmax(-1) == wanted.rule).float(),
            }

    def act_together(self, inputs: Sequence[TeamInput]) -> list[Orders]:
        """Return orders for the free robots of each episode."""
        return [self._orders(team_input) for team_input in inputs]

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        """Return the next sub-task of each episode, with all arms at rest."""
        return [self._next(one) for one in inputs]

    def _next(self, given: PolicyInput) -> SubTask:
        """Return the next sub-task of one episode, with all arms at rest."""
        if _has_failed(given):
            return self._planned(given, given.view, 1)[0][0]
        steps, todo, _ = self._left(given, [step.subtask for step in given.past])
        return steps[todo[0]] if todo else STOP

    def _left(
        self, given: PolicyInput, begun: Sequence[SubTask]
    ) -> tuple[list[SubTask], list[int], Rule | None]:
        """Return the plan from the first view, what is left of it, and the rule."""
        first = given.past[0].view if given.past else given.view
        plan, rule = self._planned(given, first, _LONGEST)
        steps = [step for step in plan if step != STOP]
        # No sub-task comes twice in a plan.
        todo = [k for k, step in enumerate(steps) if step not in begun]
        return steps, todo, rule

    def _orders(self, given: TeamInput) -> Orders:
        """Return orders for one episode."""
        failed = _has_failed(given)
        if given.doing and (failed or not given.past):
            return Orders()
        if failed:
            return Orders((Decision(self._next(given), None),))
        begun = [step.subtask for step in given.past]
        begun += [doing.subtask for doing in given.doing.values()]
        steps, todo, rule = self._left(given, begun)
        if not todo:
            return Orders() if given.doing else Orders((Decision(STOP, None),))
        ended = [step.subtask for step in given.past]
        found = next_orders(steps, todo, given.free, ended, rule)
        return Orders(tuple(Decision(steps[k], None) for k in found))

    def _planned(
        self, given: PolicyInput, view: View, most: int
    ) -> tuple[list[SubTask], Rule | None]:
        """Return a plan from a view with all arms at rest, and the rule of the goal.

        Args:
            given: Input, whose first view shows the table at the beginning.
            view: The view to plan from.
            most: Largest number of sub-tasks; the last one may be ``stop``.
        """
        colors = [name.split()[-2] for name in given.robots]
        team = distinct(colors)
        with self.deciding():
            table, read = self._look(given, view, colors)
            cargo, targets = self.entities.cargo, self.entities.stick
            steps: list[SubTask] = []
            cost = self._costs(given, team)
            while len(steps) < most and (not steps or steps[-1] != STOP):
                scores = self.planner(table, read).log_softmax(-1) - cost
                move = move_of(scores.argmax(1), cargo, targets)
                steps.append(move_named(move[0].tolist(), team, self.entities))
                table = table.moved(move[:, 1], move[:, 2])
                # A thing goes to each place at most once in a plan.
                every = torch.arange(ROBOTS, device=self.device)[:, None]
                again = torch.cat([every, move[:, 1:].expand(ROBOTS, -1)], 1)
                if steps[-1] != STOP:
                    cost[number_of(again, cargo, targets)] = _LOUDEST
        return steps, rule_of_times(read, self.entities)

    def _look(
        self, given: PolicyInput, view: View, colors: Sequence[str]
    ) -> tuple[TeamTable, Reading]:
        """Return the scene in a view, and the reading of the instruction."""
        team = distinct(colors)
        first = given.past[0].view if given.past else given.view
        there = numbers_by_color([team], self.device) >= 0
        weak = weak_hands([given.hands], [team], self.device)
        words = self.reader.sentences.read([given.instruction], self.device)
        seen = self._seen(replace(given, view=first), team)
        start = self.eye.look(*seen, there, weak)
        said = named_colors([colors], self.device)
        read = self.reader.understand(words, start, said, _UNSEEN).decided()
        named = named_entities(read, self.entities)
        start = self.eye.look(*seen, there, weak, named)
        if view is first:
            return start, read
        seen = self._seen(replace(given, view=view), team)
        now = self.eye.look(*seen, there, weak)
        memory = start
        for step in given.past:
            if step.outcome == _SUCCESS and step.subtask.primitive == Primitive.MOVE:
                move = numbers_of(step.subtask, team, self.entities).to(self.device)
                memory = memory.moved(move[:, 1], move[:, 2])
        return recalled(now, memory), read

    def _seen(
        self, given: PolicyInput, team: tuple[str, ...]
    ) -> tuple[Marks, Tensor, Batch]:
        """Return marks and coarse features of a view, and the view as a batch."""
        views = self._views.valid(self.eye)
        found = views.get(given.view)
        if found is None:
            (batch,) = self.batches([given.with_past(())])
            batch, _ = colored(batch, numbers_by_color([team], self.device))
            found = views[given.view] = (*self.eye(batch), batch)
        return found

    def _costs(self, given: PolicyInput, team: tuple[str, ...]) -> Tensor:
        """Return what to subtract from scores of moves that have failed."""
        entities = self.entities
        cargo, targets = entities.cargo, entities.stick
        costs = torch.zeros(ROBOTS * cargo * (targets + len(REGIONS)) + 1)
        for subtask in given.failed:
            if subtask.primitive == Primitive.MOVE:
                move = numbers_of(subtask, team, entities)
                costs[number_of(move, cargo, targets)] += self.config.failure_cost
        if len(given.failed) >= _MOST_FAILURES:
            costs[:-1] += _LOUDEST * _LOUDEST
        return costs.to(self.device)


def _at_rest(wanted: Wanted, labels: Labels) -> Tensor:
    """Return whether all arms are at rest, (B,) bool.

    Demonstrations of the rule ``together`` have keyframes with arms at work.
    """
    together = wanted.rule == RULES.index(Together.kind)
    return ~together | (labels.keyframe == 0)


def _has_failed(given: PolicyInput) -> bool:
    return any(step.outcome != _SUCCESS for step in given.past)


MODELS.add("team-reachnet", (TeamReachNet, TeamReachNetConfig))
