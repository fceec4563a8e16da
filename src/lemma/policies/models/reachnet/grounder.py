"""ReachNet's grounder: from a table and a sub-task to the gripper's poses.

Poses hang on entities: what is picked, what it is put on, how the stick must lie. What
is not determined by that, a free spot or the bearing of a drag, is the candidate of
highest learned utility.
"""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.policies.batch import NOBODY, PRIMITIVES
from lemma.policies.models.reachnet.drags import (
    SIGNS,
    TRAVELS_M,
    TURNS_RAD,
    DragUtility,
    straight,
)
from lemma.policies.models.reachnet.scene_table import SceneTable
from lemma.policies.models.reachnet.spots import CubeSpots, StickSpots
from lemma.policies.models.reachnet.tool_shape import HALF_M, stick_distance
from lemma.robots.gripper import FINGER_CENTER_M, FINGER_DISC_M

_PREPARE = (PRIMITIVES.index("prehook"), PRIMITIVES.index("prepoke"))
_USE = (PRIMITIVES.index("hook"), PRIMITIVES.index("poke"))
_MOVE = PRIMITIVES.index("move")
_QUARTER_RAD = 0.5 * math.pi
_ENOUGH_M = 0.008
_FLAT_M = 0.01
"""Fingers that grasp something come down over what is lower than this."""
_SAFE_M = 0.008
"""Margin inside a robot's reach, which is seen with some error."""
_OUTSIDE = 1e4
"""Cost of a metre outside."""
_STICK_SHARE = 8
"""At most one in so many frames lays the stick down; more are not looked at."""


class ReachNetGrounder(nn.Module):
    """Where exactly."""

    def __init__(self, use_reach: bool) -> None:
        """Make the weights.

        Args:
            use_reach: Whether reach is known.
        """
        super().__init__()
        self.drags = DragUtility(use_reach)
        self.cube_spots = CubeSpots(use_reach)
        self.stick_spots = StickSpots(use_reach)

    def forward(self, table: SceneTable, decision: Tensor) -> tuple[Tensor, Tensor]:
        """Return the gripper's poses where it closes and where the motion ends.

        Args:
            table: B scenes.
            decision: Sub-tasks, (B, 4).

        Returns:
            Two of (B, 3): x, y [m], yaw [rad]. NaN where an entity is not seen, and
            for ``stop``.
        """
        robot, primitive, pick, place = decision.clamp(min=0).unbind(-1)
        rows = torch.arange(len(table), device=robot.device)
        picked = pick == table.stick
        grasp = torch.cat([table.grasp, table.yaw[:, table.stick, None]], 1)
        cube = self._cube_grasp(table, robot, pick)
        start = torch.where(picked[:, None], grasp, cube)
        shared = place >= table.xy.shape[1]
        support = place.clamp(max=table.xy.shape[1] - 1)
        spot = self.cube_spots.pose(self.cube_spots(table, pick).argmax(-1))
        xy = torch.where(shared[:, None], spot, table.xy[rows, support])
        moved = self._carried(table, start, xy, (robot, pick, support), shared)
        laid = self.stick_spots.pose(self.stick_spots(table, robot).argmax(-1))
        prepared, used = self._with_stick(table, start, robot, primitive, support)
        end = torch.where((picked & (primitive == _MOVE))[:, None], laid, moved)
        end = torch.where(_among(primitive, _PREPARE)[:, None], prepared, end)
        end = torch.where(dragged(primitive)[:, None], used, end)
        seen = table.present[rows, pick] & (shared | table.present[rows, support])
        seen = (seen & (decision[:, 0] != NOBODY))[:, None]
        return torch.where(seen, start, torch.nan), torch.where(seen, end, torch.nan)

    def losses(
        self, table: SceneTable, decision: Tensor, pick: Tensor, place: Tensor
    ) -> dict[str, Tensor]:
        """Return how unlikely the demonstrated candidates are.

        Args:
            table: B scenes.
            decision: Sub-tasks, (B, 4).
            pick: Demonstrated pose, (B, 3).
            place: Demonstrated pose, (B, 3).
        """
        table = table.detached()
        entity = decision[:, 2].clamp(min=0)
        place = place.nan_to_num()
        to_shared = decision[:, 3] == table.xy.shape[1]
        spots = self.cube_spots(table, entity).log_softmax(-1)
        number = self.cube_spots.number(place[:, :2])
        cube = _mean(
            -spots.gather(1, number[:, None])[:, 0], to_shared & (entity != table.stick)
        )
        hand = to_shared & (entity == table.stick)
        some = hand.float().topk(math.ceil(len(hand) / _STICK_SHARE)).indices
        robot = decision[some, 0].clamp(min=0)
        laid = self.stick_spots(table.rows(some), robot).log_softmax(-1)
        number = self.stick_spots.number(place[some])
        stick = _mean(-laid.gather(1, number[:, None])[:, 0], hand[some])
        found = self._drag_losses(table, decision, pick.nan_to_num(), place)
        return {"cube_spot": cube, "stick_spot": stick, **found}

    def _drag_losses(
        self, table: SceneTable, decision: Tensor, pick: Tensor, place: Tensor
    ) -> dict[str, Tensor]:
        robot, primitive, _, target = decision.clamp(min=0).unbind(-1)
        cube = target.clamp(max=table.cargo - 1)
        prepares, uses = _among(primitive, _PREPARE), dragged(primitive)
        utility, _, _ = self._choices(table, robot, primitive, cube)
        rows = torch.arange(len(table), device=robot.device)
        at = table.xy[rows, cube]
        yaw = torch.where(uses, pick[:, 2], place[:, 2])
        turn = _nearest_turn(table, at, (robot, primitive), yaw)
        bearing = utility.flatten(1).log_softmax(-1).view_as(utility).logsumexp(-1)
        travel = (place[:, :2] - pick[:, :2]).norm(dim=-1)
        lengths = torch.tensor(TRAVELS_M, device=travel.device)
        length = (travel[:, None] - lengths).abs().argmin(-1)
        given = utility[rows, turn].log_softmax(-1)[rows, length]
        offset = at - place[:, :2]
        cos, sin = place[:, 2].cos(), place[:, 2].sin()
        x, y = offset.unbind(-1)
        seen = torch.stack([x * cos + y * sin, y * cos - x * sin], -1)
        ready = self.drags.ready(table.traits.drag_m[cube])
        ready = ready[_side(primitive), rows]
        miss = F.smooth_l1_loss(seen, ready, beta=0.01, reduction="none").sum(-1)
        near = (seen - ready.detach()).norm(dim=-1) < 0.3
        return {
            "bearing": _mean(-bearing[rows, turn], prepares),
            "length": _mean(-given, uses),
            "ready": 10.0 * _mean(miss, prepares & near),
        }

    def _choices(
        self, table: SceneTable, robot: Tensor, primitive: Tensor, cube: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return utility (B, T, L), bearings (B, T) and poses (B, T, 2) of drags."""
        rows = torch.arange(len(table), device=robot.device)
        drags = self.drags.drags(table, cube[:, None])
        side, utility = _side(primitive), self.drags(drags)
        index = (rows, robot, side, 0)
        return utility[index], drags.bearings[index], drags.prepared[index]

    def _with_stick(
        self,
        table: SceneTable,
        start: Tensor,
        robot: Tensor,
        primitive: Tensor,
        place: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """Return the gripper's pose after preparing and after using the stick."""
        rows = torch.arange(len(table), device=robot.device)
        cube = place.clamp(max=table.cargo - 1)
        utility, bearings, poses = self._choices(table, robot, primitive, cube)
        signs = torch.tensor(SIGNS, device=start.device)[_side(primitive)]
        lengths = torch.tensor(TRAVELS_M, device=start.device)
        steps = signs[:, None] * lengths
        ahead = torch.stack([bearings.cos(), bearings.sin()], -1)
        ends = poses[:, :, None] + steps[:, None, :, None] * ahead[:, :, None]
        apart = self._beyond(table, poses, robot)[..., None]
        apart = apart + self._beyond(table, ends, robot, low=True)
        turn = (utility - _OUTSIDE * apart).amax(-1).argmax(-1)
        prepared = torch.cat([poses[rows, turn], bearings[rows, turn, None]], 1)
        at = table.xy[rows, cube]
        lying = _nearest_turn(table, at, (robot, primitive), start[:, 2])
        along = torch.stack([start[:, 2].cos(), start[:, 2].sin()], -1)
        used = start[:, None, :2] + steps[..., None] * along[:, None]
        apart = self._beyond(table, used, robot, low=True)
        worth = utility[rows, lying] - _OUTSIDE * apart
        used = used[rows, worth.argmax(-1)]
        return prepared, torch.cat([used, start[:, 2:]], 1)

    def _beyond(
        self, table: SceneTable, points: Tensor, robot: Tensor, *, low: bool = False
    ) -> Tensor:
        """Return how far points (B, ..., 2) are out of a robot's safe reach [m]."""
        rows = torch.arange(len(table), device=robot.device)
        margin = table.margins(points, low=low)[rows, robot]
        beyond = (_SAFE_M - margin).clamp(min=0.0)
        return beyond * float(self.drags.use_reach)

    def _cube_grasp(self, table: SceneTable, robot: Tensor, cube: Tensor) -> Tensor:
        """Return the grasp of what is moved, with room for the fingers."""
        rows = torch.arange(len(table), device=robot.device)
        cube = cube.clamp(max=table.cargo - 1)
        at, traits = table.xy[rows, cube], table.traits
        turned = table.yaw[rows, cube] + traits.grasp_yaw[cube]
        natural = _bearing(table, at, robot)
        # Things without a preferred grasp are held along the arm, or across.
        turn = torch.where(traits.faceted[cube], traits.turn_rad[cube], _QUARTER_RAD)
        faced = turned + turn * torch.round((natural - turned) / turn)
        first = torch.where(traits.faceted[cube], faced, natural)
        yaws = torch.stack([first, first + turn], 1)
        room = self._finger_room(table, at, yaws, cube).clamp(max=_ENOUGH_M)
        yaw = torch.where(room[:, 1] > room[:, 0], yaws[:, 1], yaws[:, 0])
        return torch.cat([at, yaw[:, None]], 1)

    def _finger_room(
        self, table: SceneTable, at: Tensor, yaws: Tensor, cube: Tensor
    ) -> Tensor:
        """Return the room of the open fingers for two yaws, (B, 2) [m]."""
        across = torch.stack([-yaws.sin(), yaws.cos()], -1)
        sides = FINGER_CENTER_M * torch.stack([across, -across], 2)
        fingers = at[:, None, None] + sides
        traits, count = table.traits, table.stick
        things = table.xy[:, None, None, :count]
        apart = (fingers.unsqueeze(-2) - things).norm(dim=-1) - traits.side_m[:count]
        own = F.one_hot(cube, count).bool()[:, None, None]
        flat = traits.height_m[:count] < _FLAT_M
        apart = torch.where(own | flat, 1.0, apart).amin(-1)
        stick = stick_distance(
            table.grasp[:, None, None], table.yaw[:, table.stick, None, None], fingers
        )
        room = torch.minimum(apart, stick - HALF_M) - FINGER_DISC_M
        return room.amin(-1)

    def _carried(
        self,
        table: SceneTable,
        start: Tensor,
        xy: Tensor,
        decision: tuple[Tensor, Tensor, Tensor],
        shared: Tensor,
    ) -> Tensor:
        """Return where a cube is put down: turned as the arm turns, or by faces.

        Args:
            table: B scenes.
            start: Gripper where it closes, (B, 3).
            xy: Where it opens, (B, 2).
            decision: Who, what, on what, (B,) each.
            shared: Whether it is rather put where all reach, (B,).
        """
        robot, pick, support = decision
        rows = torch.arange(len(table), device=robot.device)
        turn = _bearing(table, xy, robot) - _bearing(table, start[:, :2], robot)
        yaw = start[:, 2] + turn
        face = table.yaw[rows, support]
        aligned = face + _QUARTER_RAD * torch.round((yaw - face) / _QUARTER_RAD)
        # Faces over faces; what lies on a fixed thing, or is round, lies as it comes.
        faceted = table.traits.faceted
        square = ~shared & faceted[support] & faceted[pick]
        yaw = torch.where(square, aligned, yaw)
        return torch.cat([xy, yaw[:, None]], 1)


def _bearing(table: SceneTable, points: Tensor, robot: Tensor) -> Tensor:
    """Return the direction in which a robot sees points (B, 2), (B,) [rad]."""
    rows = torch.arange(len(table), device=robot.device)
    ray = points - table.bases[rows, robot]
    return torch.atan2(ray[:, 1], ray[:, 0])


def _nearest_turn(
    table: SceneTable, cube: Tensor, decision: tuple[Tensor, Tensor], yaw: Tensor
) -> Tensor:
    """Return the number of the turn that a stick's yaw is nearest to, (B,).

    Args:
        table: B scenes.
        cube: Position of the dragged cube, (B, 2) [m].
        decision: Numbers of the dragging robot and of its primitive, (B,) each.
        yaw: (B,) [rad].
    """
    robot, primitive = decision
    rows = torch.arange(len(table), device=robot.device)
    turn = yaw - straight(table, cube[:, None])[rows, robot, _side(primitive), 0]
    turns = torch.tensor(TURNS_RAD, device=yaw.device)
    return (1 - torch.cos(turn[:, None] - turns)).argmin(-1)


def dragged(primitive: Tensor) -> Tensor:
    """Return which primitives drag something with the stick, bool."""
    return _among(primitive, _USE)


def _among(primitive: Tensor, numbers: tuple[int, ...]) -> Tensor:
    return (primitive == numbers[0]) | (primitive == numbers[1])


def _side(primitive: Tensor) -> Tensor:
    """Return 0 for primitives that hook and 1 for those that poke."""
    return ((primitive == _PREPARE[1]) | (primitive == _USE[1])).long()


def _mean(values: Tensor, counts: Tensor) -> Tensor:
    """Return the mean over the frames that count; 0 if none does."""
    picked = torch.where(counts, values, 0.0)
    return picked.sum() / counts.sum().clamp(min=1)
