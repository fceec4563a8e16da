"""Reading for teams: any number of (top, bottom) pairs, and a rule.

Each movable entity has a distribution over what it shall lie on, or nothing. The rule
has a kind, and the entities or the robot that it names. Words mean things by their
color, or by their place in the scene that is seen.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.core.arguments import known
from lemma.core.robot_names import robot_number
from lemma.policies.batch import NOBODY
from lemma.policies.entities import EntitySet
from lemma.policies.layers import sent
from lemma.policies.models.reachnet.goal_reader import GoalReader, ReaderConfig
from lemma.policies.models.team_reachnet.places import BY_ONE, BY_ORDER, places_in
from lemma.policies.models.team_reachnet.table import TeamTable
from lemma.policies.models.team_reachnet.teams import ROBOTS
from lemma.policies.text.encoder import NO_NAME, Sentences, groups_of
from lemma.scene.spec import ROBOT_COLORS
from lemma.tasks.language.bank import ORDINALS
from lemma.tasks.language.relational import ROBOT
from lemma.tasks.language.template import GoalPairs
from lemma.tasks.teams.rule import After, But, Rule, Together, Without

RULES = ("", "after", "without", "but", "together")
"""No rule, and the kinds of rules."""
_WITHOUT = RULES.index(Without.kind)
ROLES = ("later", "first", "kept")
"""Roles of movable entities in rules: the top of the later pair, the top of the pair
that comes first, and the one that must not be touched."""
_NEVER = -30.0
_FAR = 24
"""Largest distance of an anchor from its word; larger ones are clipped."""
_NAMED = 3
"""Number of ways to mean what a word names: it alone, or the left or right one."""
_SCALE = 10.0
"""Ratio of the learning rate of position biases to that of other weights."""


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
        after, without, but, _ = rule[:, 1:].unbind(1)
        roles = self.roles.float().softmax(-1)
        has = torch.stack([after, after, but], 1)
        return Reading(
            self.bottoms.float().softmax(-1),
            rule,
            roles * has[..., None],
            self.excluded.float().softmax(-1) * without[:, None],
        )

    def decided(self) -> "Reading":
        """Return logits as certain and consistent readings, (B, ...)."""
        return Wanted(
            _consistent(self.bottoms.float().log_softmax(-1)),
            rule := self.rule.argmax(-1),
            torch.where(_has_roles(rule), self.roles.argmax(-1), NOBODY),
            torch.where(rule == _WITHOUT, self.excluded.argmax(-1), NOBODY),
        ).shares(self.bottoms.shape[-1] - 1)


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
    return Wanted(*(sent(torch.tensor(numbers), device) for numbers in found))


class TeamReader(GoalReader):
    """A network from sentences to goals with rules."""

    robot_words: Tensor
    thing_kinds: Tensor
    alike_colors: Tensor

    def __init__(self, config: ReaderConfig, entities: EntitySet) -> None:
        """Make the weights.

        Args:
            config: Options; those of refusal do not apply.
            entities: Entities, in the order of their numbers.
        """
        super().__init__(config, entities)
        width = config.width
        names = [kind.name for kind in entities.kinds[: self.targets]]
        names += [ROBOT] * ROBOTS
        distinct = list(dict.fromkeys(names))
        self.kind = nn.Linear(width, len(distinct))
        self.relation = nn.Linear(width, _NAMED + BY_ONE + 1 + BY_ORDER)
        self.asks = nn.Linear(width, 2 * width)
        self.answers = nn.Linear(width, width)
        self.ahead = nn.Parameter(torch.zeros(2, 2 * _FAR + 1))
        self.rule = nn.Linear(width, len(RULES))
        self.own_color = nn.Linear(width, 1)
        self.role = nn.Linear(width, len(ROLES) + 1)
        # At first words mean what they name, and no goal is about own colors.
        nn.init.constant_(self.own_color.bias, -4.0)
        nn.init.constant_(self.relation.bias[:1], 3.0)
        groups, words = groups_of(entities)
        colors = [words.get(color, NOBODY) for color in ROBOT_COLORS]
        self.register_buffer("robot_words", torch.tensor(colors), persistent=False)
        kinds = torch.tensor([distinct.index(name) for name in names])
        self.register_buffer("thing_kinds", kinds, persistent=False)
        # By Python, because arithmetic without numbers loads torch's compiler.
        alike = [
            [one == other and k >= self.cargo for k, other in enumerate(groups)]
            for one in groups[: self.cargo]
        ]
        self.register_buffer("alike_colors", torch.tensor(alike), persistent=False)

    def understand(
        self,
        sentences: Sentences,
        table: TeamTable,
        colors: Tensor,
        absent: float = _NEVER,
    ) -> Reading:
        """Return the readings of sentences, as logits.

        Args:
            sentences: B sentences.
            table: The scenes that they are about.
            colors: Color by which each robot is named, (B, R).
            absent: Change of the logit of a pair if one of its entities is not there.
        """
        tokens, whole = self._encoded(sentences)
        roles = self.role(tokens).float().transpose(1, 2)
        rule, own = self.rule(whole).float(), self.own_color(whole).float()
        with torch.autocast(tokens.device.type, enabled=False):
            meant = self._meant(sentences, tokens.float(), table, colors)
            logs = meant.clamp(min=math.exp(_NEVER)).log().transpose(1, 2)
            entities, robots = logs[:, : self.cargo], logs[:, self.targets :]
            held = (roles[:, :-1, None] + entities[:, None]).logsumexp(-1)
            excluded = (roles[:, -1, None] + robots).logsumexp(-1)
            pairs = self._pairs(tokens.float(), meant)
        there = table.there
        both = there[:, : self.cargo, None] & there[:, None, : self.targets]
        # "Every cube to the pad of its color, but not the red one": of those seen.
        kept = held[:, 2:3].transpose(1, 2)
        own = own[..., None] - F.softplus(kept)
        own = torch.where(self.alike_colors & both, own, _NEVER)
        pairs = torch.logaddexp(pairs + absent * ~both, own)
        itself = torch.eye(*pairs.shape[1:], dtype=torch.bool, device=pairs.device)
        pairs = pairs.masked_fill(itself, _NEVER)
        nothing = torch.zeros_like(pairs[..., :1])
        return Reading(torch.cat([pairs, nothing], -1), rule, held, excluded)

    def _meant(
        self, sentences: Sentences, tokens: Tensor, table: TeamTable, colors: Tensor
    ) -> Tensor:
        """Return the probability that each word means each thing, (B, L, N).

        A word that names a color means the things of that color; any word may mean the
        thing at a place, such as the noun in "the cube nearest to the red robot".
        """
        groups = self.group.expand(len(tokens), -1)
        groups = torch.cat([groups, self.robot_words[colors]], 1)
        is_name = (sentences.names != NO_NAME)[..., None]
        named = ((sentences.names[..., None] == groups[:, None]) & is_name).float()
        kind = self.kind(tokens).softmax(-1)[:, :, self.thing_kinds]
        kind = kind * sentences.mask[:, :, None]
        shares = self.relation(tokens).softmax(-1)
        name, by_one, between, order = shares.split([_NAMED, BY_ONE, 1, BY_ORDER], -1)
        places = places_in(table, self.thing_kinds)
        # Two robots of one color are the left and the right one.
        ends = places.by_order[:, :: len(ORDINALS)]
        which = name[..., :1] + torch.einsum("blr,brn->bln", name[..., 1:], ends)
        found = named * which
        one, two = (self._anchors(sentences, tokens) @ (kind * found)[:, None]).unbind(
            1
        )
        found = found + torch.einsum("blr,bla,brna->bln", by_one, one, places.by_one)
        both = torch.einsum("bla,bnac->blnc", one, places.by_two)
        found = found + between * torch.einsum("blnc,blc->bln", both, two)
        found = found + torch.einsum("blr,brn->bln", order, places.by_order)
        meant: Tensor = kind * found
        return meant

    def _anchors(self, sentences: Sentences, tokens: Tensor) -> Tensor:
        """Return to which names each word refers, as its first and its second anchor.

        Returns:
            Shares of all words, (B, 2, L, L).
        """
        count, length, width = tokens.shape
        asked = self.asks(tokens).view(count, length, 2, -1).transpose(1, 2)
        fit = asked @ self.answers(tokens).transpose(1, 2)[:, None] / width**0.5
        place = torch.arange(length, device=tokens.device)
        away = (place - place[:, None]).clamp(-_FAR, _FAR) + _FAR
        fit = fit + _SCALE * self.ahead[:, away]
        is_name = sentences.names != NO_NAME
        found: Tensor = fit.masked_fill(~is_name[:, None, None], _NEVER).softmax(-1)
        return found

    def _pairs(self, tokens: Tensor, meant: Tensor) -> Tensor:
        """Return the score of each (top, bottom) pair, (B, C, T).

        Args:
            tokens: Words, (B, L, width).
            meant: Probabilities of what they mean, (B, L, N).
        """
        top, bottom = self.top(tokens), self.bottom(tokens)
        fit = top @ bottom.transpose(1, 2) / top.shape[-1] ** 0.5
        # One mention cannot be both, but two mentions may have the same color.
        same = torch.eye(tokens.shape[1], dtype=torch.bool, device=tokens.device)
        fit = fit.masked_fill(same, 2 * _NEVER)
        most = fit.amax((1, 2), keepdim=True)
        share = meant[..., : self.cargo].transpose(1, 2) @ (fit - most).exp()
        share = share @ meant[..., : self.targets]
        found: Tensor = share.clamp(min=math.exp(2 * _NEVER)).log() + most
        return found

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


def _named(logits: Tensor, wanted: Tensor) -> Tensor:
    """Return the mean loss of the rows with a wanted number, divided by all rows."""
    lost = F.cross_entropy(logits, wanted.clamp(min=0), reduction="none")
    return torch.where(wanted >= 0, lost, 0.0).sum() / max(1, len(wanted))


def _has_roles(rules: Tensor) -> Tensor:
    """Return whether rules have an entity in each role, (B, roles) bool."""
    after, but = rules == RULES.index(After.kind), rules == RULES.index(But.kind)
    return torch.stack([after, after, but], 1)


def _consistent(logs: Tensor) -> Tensor:
    """Return consistent bottoms, (B, C), -1 for none, of log-probabilities.

    The most certain top takes its bottom first. No bottom has two tops, and no top lies
    on itself, be it with others in between.
    """
    found = []
    for rows in logs.tolist():
        nothing = len(rows[0]) - 1
        bottoms: dict[int, int] = {}
        while len(bottoms) < len(rows):
            ways = [
                (row[bottom], top, bottom)
                for top, row in enumerate(rows)
                for bottom in range(nothing + 1)
                if top not in bottoms
                and (bottom == nothing or _fits(bottoms, top, bottom))
            ]
            _, top, bottom = max(ways)
            bottoms[top] = bottom
        chosen = [bottoms[top] for top in range(len(rows))]
        found.append([NOBODY if bottom == nothing else bottom for bottom in chosen])
    return torch.tensor(found, device=logs.device)


def _fits(bottoms: dict[int, int], top: int, bottom: int) -> bool:
    """Whether a top may lie on a bottom, given the bottoms of others."""
    if bottom in bottoms.values():
        return False
    below: int | None = bottom
    while below is not None and below != top:
        below = bottoms.get(below)
    return below is None


def rule_of_times(read: Reading, entities: EntitySet) -> Rule | None:
    """Return the rule of one reading if it is about the times of two parts of a goal.

    Such a rule is not visible in objects, so it decides when orders are given.
    """
    kind, targets = RULES[int(read.rule[0].argmax())], entities.stick
    if kind == After.kind:
        tops = read.roles[0, : len(ROLES) - 1].argmax(-1)
    elif kind == Together.kind:
        tops = read.bottoms[0, :, targets].topk(2, largest=False).indices
    else:
        return None
    names = []
    for top in tops.tolist():
        bottom = int(read.bottoms[0, top, :targets].argmax())
        names += [entities.names[top], entities.names[bottom]]
    return (After if kind == After.kind else Together)(*names)


def named_entities(read: Reading, entities: EntitySet) -> Tensor:
    """Return the entities of the goals that were read, (B, E) bool."""
    bottoms = read.bottoms.argmax(-1)
    tops = bottoms < entities.stick
    found = F.one_hot(bottoms, entities.stick + 1).bool().any(1)
    found[:, entities.stick] = False
    found[:, : entities.cargo] |= tops
    return found
