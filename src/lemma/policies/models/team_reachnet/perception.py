"""The team's perception: that of ReachNet, and which entities are heavy.

A heavy object has dark rims (:mod:`lemma.scene.objects.bodies`).
"""

from dataclasses import replace

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.policies.batch import Batch
from lemma.policies.entities import EntitySet
from lemma.policies.layers import constant
from lemma.policies.models.grid import Cells
from lemma.policies.models.reachnet.grounder import reach_loss
from lemma.policies.models.reachnet.marks import STRIDE, Marks
from lemma.policies.models.reachnet.perception import Perception, PerceptionConfig
from lemma.policies.models.reachnet.scene_table import SceneTable
from lemma.policies.models.team_reachnet.table import TeamTable, team_table
from lemma.policies.models.team_reachnet.teams import ROBOTS

_POINTS = 128
_LIGHT = -4.0
"""Initial logit that an entity is heavy."""


class TeamPerception(Perception):
    """A network from maps to the scenes of teams."""

    def __init__(self, config: PerceptionConfig, entities: EntitySet) -> None:
        """Make the weights.

        Args:
            config: Options.
            entities: Entities, in the order of their numbers.
        """
        super().__init__(config, ROBOTS, entities)
        self.heavy = nn.Linear(config.widths[0], 1)
        nn.init.constant_(self.heavy.bias, _LIGHT)

    def look(
        self,
        marks: Marks,
        coarse: Tensor,
        batch: Batch,
        team: Tensor,
        weak: Tensor,
        named: Tensor | None = None,
    ) -> TeamTable:
        """Return the scenes of marks and coarse features.

        Args:
            marks: Marks of the maps.
            coarse: Coarse features of the maps.
            batch: The maps, with rows of robots by color.
            team: Whether there is a robot of each color, (B, R) bool.
            weak: Whether it has another hand than the standard one, (B, R) bool.
            named: Entities that are there even if they are hard to see, (B, E) bool.
        """
        found = team_table(self.table(marks, coarse, batch, named), team, weak)
        heavy = found.there & (self._weighed(marks, found.xy, batch) > 0.0)
        return replace(found, heavy=heavy.float())

    def reaches(self, scene: SceneTable, known: Tensor, batch: Batch) -> Tensor:
        """Return the loss of which points each robot reaches.

        Args:
            scene: True scenes, with the radii of reach that are seen.
            known: True radii [m], (B, R, 3).
            batch: The maps.
        """
        sides = constant((batch.raster.columns, batch.raster.rows), known.device)
        share = torch.rand(len(batch), _POINTS, 2, device=known.device) * 2 - 1
        points = share * sides * (batch.raster.cell_m / 2)
        return reach_loss(scene, known, scene.bases, points)

    def weight_loss(
        self, marks: Marks, there: Tensor, xy: Tensor, heavy: Tensor, batch: Batch
    ) -> Tensor:
        """Return the loss of which entities are heavy.

        Args:
            marks: Marks of the maps.
            there: Whether entities are on the table, (B, E) bool.
            xy: Their true positions [m], (B, E, 2).
            heavy: Whether they are heavy, (B, E) bool.
            batch: The maps.
        """
        logits = self._weighed(marks, xy, batch)
        lost = F.binary_cross_entropy_with_logits(
            logits, heavy.float(), reduction="none"
        )
        return torch.where(there, lost, 0.0).sum() / there.sum().clamp(min=1)

    def _weighed(self, marks: Marks, xy: Tensor, batch: Batch) -> Tensor:
        """Return the logits that entities at positions are heavy, (B, E)."""
        cell = Cells.of(batch.raster, STRIDE).holding(xy)
        index = cell[:, None].expand(-1, marks.features.shape[1], -1)
        features = marks.features.gather(2, index).transpose(1, 2)
        found: Tensor = self.heavy(features).squeeze(2)
        return found
