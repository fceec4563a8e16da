"""Reading for teams: any number of (top, bottom) pairs, and a rule.

Each movable entity has a distribution over what it shall lie on, or nothing. The rule
has a kind, and the entities or the robot that it names.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.core.arguments import known
from lemma.core.robot_names import robot_number
from lemma.policies.batch import NOBODY
from lemma.policies.entities import EntitySet
from lemma.policies.models.reachnet.goal_reader import GoalReader, ReaderConfig
from lemma.policies.models.team_reachnet.teams import ROBOTS
from lemma.policies.text.encoder import Sentences, groups_of
from lemma.scene.spec import ROBOT_COLORS
from lemma.tasks.language.template import GoalPairs
from lemma.tasks.teams.rule import After, Rule

RULES = ("", "after", "without", "but")
"""No rule, and the kinds of rules."""
ROLES = ("later", "first", "kept")
"""Roles of movable entities in rules: the top of the later pair, the top of the pair
that comes first, and the one that must not be touched."""
_MENTIONS = 16
_NEVER = -30.0


class Reading(NamedTuple):
    """Readings of B sentences: logits, or shares of 0 to 1."""

    bottoms: Tensor
    """The bottom of each movable entity in the goal; the last one stands for none,
    (B, C, T + 1)."""
    rule: Tensor
    """Kind of the rule, (B, kinds)."""
    roles: Tensor
    """Movable entity in each role of the rule, (B, roles, C)."""
    excluded: Tensor
    """Robot that the rule excludes, by color, (B, R)."""

    def shares(self) -> "Reading":
        """Return logits as shares; those of roles only for the rules that have them."""
        rule = self.rule.float().softmax(-1)
        after, without, but = rule[:, 1:].unbind(1)
        roles = self.roles.float().softmax(-1)
        has = torch.stack([after, after, but], 1)
        return Reading(
            self.bottoms.float().softmax(-1),
            rule,
            roles * has[..., None],
            self.excluded.float().softmax(-1) * without[:, None],
        )


class Wanted(NamedTuple):
    """Meanings of B sentences as numbers; -1 for none."""

    bottoms: Tensor
    """The bottom of each movable entity in the goal, (B, C)."""
    rule: Tensor
    """Index of the kind of rule, (B,)."""
    roles: Tensor
    """Movable entity in each role, (B, roles)."""
    excluded: Tensor
    """Color of the excluded robot, (B,)."""

    def shares(self, targets: int) -> Reading:
        """Return them as certain readings, with T targets."""

        def hot(numbers: Tensor, count: int) -> Tensor:
            return F.one_hot(numbers + 1, count + 1)[..., 1:].float()

        nothing = torch.where(self.bottoms < 0, targets, self.bottoms)
        return Reading(
            F.one_hot(nothing, targets + 1).float(),
            F.one_hot(self.rule, len(RULES)).float(),
            hot(self.roles, self.bottoms.shape[1]),
            hot(self.excluded, ROBOTS),
        )


def wanted_of(
    goals: Sequence[GoalPairs],
    rules: Sequence[tuple[str, ...]],
    teams: Sequence[tuple[str, ...]],
    entities: EntitySet,
    device: torch.device,
) -> Wanted:
    """Return goals and rules as numbers.

    Args:
        goals: The (top, bottom) pairs of each goal.
        rules: Rules as plain data; empty for none.
        teams: Colors of the robots, in the order of their numbers.
        entities: Entities, in the order of their numbers.
        device: Device of the result.

    Raises:
        UnknownNameError: A rule is of a kind that the reader does not know.
    """
    bottoms, kinds, roles, excluded = [], [], [], []
    for goal, rule, team in zip(goals, rules, teams, strict=True):
        row, held, robot = [NOBODY] * entities.cargo, [NOBODY] * len(ROLES), NOBODY
        for top, bottom in goal:
            row[entities.number(top)] = entities.number(bottom)
        kind, *names = rule or ("",)
        if kind == "after":
            held[:2] = entities.number(names[0]), entities.number(names[2])
        elif kind == "but":
            held[2] = entities.number(names[0])
        elif kind == "without":
            robot = ROBOT_COLORS.index(team[robot_number(names[0])])
        bottoms.append(row)
        kinds.append(RULES.index(known("kind of rule", kind, RULES)))
        roles.append(held)
        excluded.append(robot)
    found = (bottoms, kinds, roles, excluded)
    return Wanted(*(torch.tensor(numbers, device=device) for numbers in found))


class TeamReader(GoalReader):
    """A network from sentences to goals with rules."""

    robots: Tensor
    alike_colors: Tensor

    def __init__(self, config: ReaderConfig, entities: EntitySet) -> None:
        """Make the weights.

        Args:
            config: Options; those of refusal do not apply.
            entities: Entities, in the order of their numbers.
        """
        super().__init__(config, entities)
        width = config.width
        self.rule = nn.Linear(width, len(RULES))
        self.own_color = nn.Linear(width, 1)
        self.role = nn.Linear(width, len(ROLES) + 1)
        nn.init.constant_(self.own_color.bias, -4.0)
        groups, words = groups_of(entities)
        robots = torch.tensor([words.get(color, NOBODY) for color in ROBOT_COLORS])
        self.register_buffer("robots", robots, persistent=False)
        # By Python, because arithmetic without numbers loads torch's compiler.
        alike = [
            [one == other and k >= self.cargo for k, other in enumerate(groups)]
            for one in groups[: self.cargo]
        ]
        self.register_buffer("alike_colors", torch.tensor(alike), persistent=False)

    def understand(
        self, sentences: Sentences, there: Tensor, absent: float = _NEVER
    ) -> Reading:
        """Return the readings of sentences, as logits.

        Args:
            sentences: B sentences.
            there: Entities on the table, (B, E) bool.
            absent: Change of the logit of a pair if one of its entities is not there.
        """
        found = self.mentions(sentences, _MENTIONS)
        meant = found.group[:, :, None] == self.group
        roles = self.role(found.said).float().transpose(1, 2)
        of_robots = found.group[:, :, None] == self.robots
        cargo = meant[:, :, : self.cargo]
        held = _of_mentions(roles[:, :-1, :, None], cargo[:, None])
        excluded = _of_mentions(roles[:, -1, :, None], of_robots)
        pairs = self.pairs(found.said, meant)
        both = there[:, : self.cargo, None] & there[:, None, : self.targets]
        # "Every cube to the pad of its color, but not the red one": of those seen.
        kept = held[:, 2:3].transpose(1, 2)
        own = self.own_color(found.whole).float()[..., None] - F.softplus(kept)
        own = torch.where(self.alike_colors & both, own, _NEVER)
        pairs = torch.logaddexp(pairs + absent * ~both, own)
        itself = torch.eye(*pairs.shape[1:], dtype=torch.bool, device=pairs.device)
        pairs = pairs.masked_fill(itself, _NEVER)
        nothing = torch.zeros_like(pairs[..., :1])
        bottoms = torch.cat([pairs, nothing], -1)
        return Reading(bottoms, self.rule(found.whole).float(), held, excluded)

    def reading_loss(self, read: Reading, wanted: Wanted) -> dict[str, Tensor]:
        """Return the losses of logits by name."""
        targets = read.bottoms.shape[-1] - 1
        bottoms = torch.where(wanted.bottoms < 0, targets, wanted.bottoms)
        reading = F.cross_entropy(read.bottoms.flatten(0, 1), bottoms.flatten())
        rule = F.cross_entropy(read.rule, wanted.rule)
        names = [
            _named(read.roles[:, i], wanted.roles[:, i]) for i in range(len(ROLES))
        ]
        names.append(_named(read.excluded, wanted.excluded))
        return {
            "reading": 3.0 * reading,
            "rule": rule,
            "named": torch.stack(names).sum(),
        }


def _of_mentions(scores: Tensor, meant: Tensor) -> Tensor:
    """Return the score of each thing: the sum over the mentions that may name it.

    Args:
        scores: Of mentions, (..., M, 1).
        meant: Whether a mention may name a thing, (..., M, N) bool.
    """
    kept = torch.where(meant, scores, _NEVER)
    found: Tensor = kept.logsumexp(-2).clamp(min=_NEVER)
    return found


def _named(logits: Tensor, wanted: Tensor) -> Tensor:
    """Return the mean loss of the rows with a wanted number, divided by all rows."""
    lost = F.cross_entropy(logits, wanted.clamp(min=0), reduction="none")
    return torch.where(wanted >= 0, lost, 0.0).sum() / max(1, len(wanted))


def order_of_parts(read: Reading, entities: EntitySet) -> Rule | None:
    """Return the rule of one reading if it orders two parts of a goal."""
    if RULES[int(read.rule[0].argmax())] != After.kind:
        return None
    tops = read.roles[0, : len(ROLES) - 1].argmax(-1).tolist()
    targets = entities.stick
    names = []
    for top in tops:
        bottom = int(read.bottoms[0, top, :targets].argmax())
        names += [entities.names[top], entities.names[bottom]]
    return After(*names)


def named_entities(read: Reading, entities: EntitySet) -> Tensor:
    """Return the entities of the goals that were read, (B, E) bool."""
    bottoms = read.bottoms.argmax(-1)
    tops = bottoms < entities.stick
    found = F.one_hot(bottoms, entities.stick + 1).bool().any(1)
    found[:, entities.stick] = False
    found[:, : entities.cargo] |= tops
    return found
