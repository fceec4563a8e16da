"""ReachNet's grounder: from a scene table and a sub-task to the gripper's poses.

Poses follow from the poses of entities: the picked object, its support, and the stick.
The remaining choices, a free position or the bearing of a drag, are candidates, of
which the grounder takes the one with the highest learned utility. The scores of
decisions and of perception, and the loss of reach from demonstrations, are here, too.
"""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.policies.batch import NOBODY, PRIMITIVES, Labels
from lemma.policies.entities import BENCHMARK, EntitySet, traits_of
from lemma.policies.layers import constant
from lemma.policies.models.reachnet.drags import (
    SIGNS,
    TRAVELS_M,
    TURNS_RAD,
    straight,
)
from lemma.policies.models.reachnet.scene_table import (
    HALF_M,
    SceneTable,
    stick_distance,
)
from lemma.policies.models.reachnet.utility import CubeSpots, DragUtility, StickSpots
from lemma.robots.gripper import FINGER_CENTER_M, FINGER_DISC_M
from lemma.scene.raster import Raster

_PREPARE = (PRIMITIVES.index("prehook"), PRIMITIVES.index("prepoke"))
_USE = (PRIMITIVES.index("hook"), PRIMITIVES.index("poke"))
_MOVE = PRIMITIVES.index("move")
_PICK_M, _ON_M, _SHARED_M = 0.02, 0.02, 0.06
_YAW_RAD, _BEARING_RAD = math.radians(10.0), math.radians(4.0)
_LENGTH_M = 0.03
_EDGE_M = 0.05
_LEAST_RAD = 1e-3
_REACH_EDGE_M = 0.006
_TIGHT = 0.2
_DEMONSTRATED = 0.3
_QUARTER_RAD = 0.5 * math.pi
_ENOUGH_M = 0.008
_FLAT_M = 0.01
"""Lower objects are no obstacles for the fingers."""
_SAFE_M = 0.008
"""Safety margin inside a robot's estimated reach."""
_OUTSIDE = 1e4
"""Cost per meter outside of the reach."""
_STICK_SHARE = 8
"""Inverse of the share of frames in the loss of the stick's place: few frames have
one."""


class ReachNetGrounder(nn.Module):
    """A network from sub-tasks to poses."""

    def __init__(self, use_reach: bool) -> None:
        """Make the weights.

        Args:
            use_reach: Whether to use the estimated reach.
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
            Two tensors (B, 3): x, y [m], yaw [rad]. NaN for ``stop``, and if an entity
            is not seen.
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
        """Return the negative log-likelihood of the demonstrated candidates.

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
        lengths = constant(TRAVELS_M, travel.device)
        length = (travel[:, None] - lengths).abs().argmin(-1)
        length_score = utility[rows, turn].log_softmax(-1)[rows, length]
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
            "length": _mean(-length_score, uses),
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
        signs = constant(SIGNS, start.device)[_side(primitive)]
        lengths = constant(TRAVELS_M, start.device)
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
        """Return distances of points (B, ..., 2) from a robot's safe reach [m]."""
        rows = torch.arange(len(table), device=robot.device)
        margin = table.margins(points, low=low)[rows, robot]
        beyond = (_SAFE_M - margin).clamp(min=0.0)
        return beyond * float(self.drags.use_reach)

    def _cube_grasp(self, table: SceneTable, robot: Tensor, cube: Tensor) -> Tensor:
        """Return the grasp of an object, (B, 3), with room for the fingers."""
        rows = torch.arange(len(table), device=robot.device)
        cube = cube.clamp(max=table.cargo - 1)
        at, traits = table.xy[rows, cube], table.traits
        turned = table.yaw[rows, cube] + traits.grasp_yaw[cube]
        natural = _bearing(table, at, robot)
        # Objects without faces are grasped along the arm or across it.
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
        """Return the place pose of an object, (B, 3), with aligned faces if needed.

        Args:
            table: B scenes.
            start: Gripper's pose where it closes, (B, 3).
            xy: Position where it opens [m], (B, 2).
            decision: Numbers of robot, object and support, (B,) each.
            shared: Whether it is placed in the shared region instead, (B,).
        """
        robot, pick, support = decision
        rows = torch.arange(len(table), device=robot.device)
        turn = _bearing(table, xy, robot) - _bearing(table, start[:, :2], robot)
        yaw = start[:, 2] + turn
        face = table.yaw[rows, support]
        aligned = face + _QUARTER_RAD * torch.round((yaw - face) / _QUARTER_RAD)
        # Align faces with those of the support; other places keep the arm's rotation.
        faceted = table.traits.faceted
        square = ~shared & faceted[support] & faceted[pick]
        yaw = torch.where(square, aligned, yaw)
        return torch.cat([xy, yaw[:, None]], 1)


def _bearing(table: SceneTable, points: Tensor, robot: Tensor) -> Tensor:
    """Return the bearing of points (B, 2) from a robot's base, (B,) [rad]."""
    rows = torch.arange(len(table), device=robot.device)
    ray = points - table.bases[rows, robot]
    return torch.atan2(ray[:, 1], ray[:, 0])


def _nearest_turn(
    table: SceneTable, cube: Tensor, decision: tuple[Tensor, Tensor], yaw: Tensor
) -> Tensor:
    """Return the index of the candidate bearing nearest to a stick's yaw, (B,).

    Args:
        table: B scenes.
        cube: Position of the dragged cube, (B, 2) [m].
        decision: Numbers of the dragging robot and of its primitive, (B,) each.
        yaw: (B,) [rad].
    """
    robot, primitive = decision
    rows = torch.arange(len(table), device=robot.device)
    turn = yaw - straight(table, cube[:, None])[rows, robot, _side(primitive), 0]
    turns = constant(TURNS_RAD, yaw.device)
    return (1 - torch.cos(turn[:, None] - turns)).argmin(-1)


def dragged(primitive: Tensor) -> Tensor:
    """Return whether primitives drag an object with the stick, bool."""
    return _among(primitive, _USE)


def _among(primitive: Tensor, numbers: tuple[int, ...]) -> Tensor:
    return (primitive == numbers[0]) | (primitive == numbers[1])


def _side(primitive: Tensor) -> Tensor:
    """Return 0 for ``prehook`` and ``hook``, 1 for ``prepoke`` and ``poke``."""
    return ((primitive == _PREPARE[1]) | (primitive == _USE[1])).long()


def _mean(values: Tensor, counts: Tensor) -> Tensor:
    """Return the mean over the frames that count; 0 without any."""
    picked = torch.where(counts, values, 0.0)
    return picked.sum() / counts.sum().clamp(min=1)


Poses = tuple[Tensor, Tensor]
"""Gripper's poses where it closes and where the motion ends, (B, 3) each."""


def score_decisions(
    decision: Tensor,
    poses: Poses,
    demonstrated: Poses,
    labels: Labels,
    entities: EntitySet = BENCHMARK,
) -> dict[str, Tensor]:
    """Return scores by name, (B,) each; NaN for frames without the score.

    Args:
        decision: Predicted decisions, (B, 4).
        poses: Poses for these decisions.
        demonstrated: Poses for the decisions of the demonstration.
        labels: The demonstration.
        entities: Entities, in the order of their numbers.
    """
    right = labels.decision
    acts = right[:, 0] != NOBODY
    same = decision == right
    plan = same.all(1)
    placed = _placed(demonstrated[1], labels, entities)
    picked = _picked(demonstrated[0], labels, entities)
    own = _picked(poses[0], labels, entities) & _placed(poses[1], labels, entities)
    prepares = _among(right[:, 1], _PREPARE)
    bearing = (
        _off(demonstrated[1][:, 2], labels.place_pose[:, 2], math.tau) < _BEARING_RAD
    )
    return {
        "primitive": same[:, 1].float(),
        "pick": _only(same[:, 2], acts),
        "place": _only(same[:, 3], acts),
        "robot": _only(same[:, 0], acts),
        "plan": plan.float(),
        "pick_2cm": _only(picked, acts),
        "place_pose": _only(placed, acts),
        "bearing": _only(bearing, prepares),
        "decision": (plan & (own | ~acts)).float(),
    }


def score_perception(
    table: SceneTable, truth: SceneTable, raster: Raster
) -> dict[str, Tensor]:
    """Return scores of the perception by name, (B,) each.

    Args:
        table: Predicted scene.
        truth: True scene.
        raster: Raster of the map.
    """
    both = table.present & truth.present
    off = (table.xy - truth.xy).norm(dim=-1)
    millimetres = torch.where(both, off, torch.nan).nanmean(1)
    share = torch.linspace(-0.36, 0.36, 25, device=off.device)
    width, depth = raster.size_m
    points = torch.cartesian_prod(share * width, share * depth)
    points = points.expand(len(off), -1, -1)
    true = truth.margins(points)
    agree = ((table.margins(points) > 0) == (true > 0)).float()
    clear = true.abs() > _EDGE_M
    return {
        "present": (table.present == truth.present).all(1).float(),
        "near": torch.exp(-millimetres / 0.01),
        "reach": (agree * clear).flatten(1).sum(1) / clear.flatten(1).sum(1),
    }


def _only(values: Tensor, counts: Tensor) -> Tensor:
    return torch.where(counts, values.float(), torch.nan)


def _picked(pose: Tensor, labels: Labels, entities: EntitySet) -> Tensor:
    """Return whether a pick pose would grasp the right object, (B,)."""
    apart: Tensor = (pose[:, :2] - labels.pick_pose[:, :2]).norm(dim=1)
    # A cube has equivalent grasps by quarter turns, a round object any grasp.
    turns = traits_of(entities, pose.device).turn_rad
    turn = turns[labels.decision[:, 2].clamp(min=0)].clamp(min=_LEAST_RAD)
    off = _off(pose[:, 2], labels.pick_pose[:, 2], turn)
    return (apart < _PICK_M) & (off < _YAW_RAD)


def _placed(pose: Tensor, labels: Labels, entities: EntitySet) -> Tensor:
    """Return whether a place pose is right, (B,)."""
    _, primitive, pick, place = labels.decision.unbind(1)
    distance: Tensor = (pose[:, :2] - labels.place_pose[:, :2]).norm(dim=1)
    yaw, wanted = pose[:, 2], labels.place_pose[:, 2]
    shared, faceted = place == entities.shared, traits_of(entities, yaw.device).faceted
    limit = torch.where(shared, _SHARED_M, _ON_M)
    near = distance < torch.where(dragged(primitive), _LENGTH_M, limit)
    square = _off(yaw, wanted, 0.5 * math.pi) < _YAW_RAD
    ahead = _off(yaw, wanted, math.tau) < _BEARING_RAD
    # With the stick, the place is the object it acts on; its yaw is checked below.
    known = place.clamp(0, entities.stick)
    by_faces = (pick != entities.stick) & faceted[pick.clamp(min=0)]
    by_faces = by_faces & ~shared & faceted[known]
    good = torch.where(by_faces, square, torch.ones_like(square))
    good = torch.where(_among(primitive, _PREPARE), ahead, good)
    return near & good


def _off(yaw: Tensor, wanted: Tensor, turn: Tensor | float) -> Tensor:
    """Return the difference of angles up to a rotational symmetry ``turn`` [rad]."""
    off = yaw - wanted
    return (off - turn * torch.round(off / turn)).abs()


def reach_loss(
    table: SceneTable, radii: Tensor, bases: Tensor, points: Tensor
) -> Tensor:
    """Return the loss of the estimated reach at points of the table.

    Args:
        table: Scenes with the estimated radii.
        radii: The true radii, (B, R, 3) [m].
        bases: The true bases, (B, R, 2) [m].
        points: World positions, (B, N, 2) [m].
    """
    near = (points[:, None] - bases[:, :, None]).norm(dim=-1).unsqueeze(2)
    true, seen = (
        torch.minimum(near - r[..., :1, None], r[..., 1:, None] - near)
        for r in (radii, table.radii)
    )
    wrong = F.binary_cross_entropy_with_logits(seen / 0.03, (true > 0).float())
    return wrong + 10.0 * F.smooth_l1_loss(seen, true, beta=0.02)


def demonstrated_reach(seen: SceneTable, labels: Labels) -> Tensor:
    """Return the negative log-likelihood of the demonstrated robots, by reach alone.

    The acting robot reached both ends, and was more likely than the others.
    Demonstrations do not show the limits of the reach. So points are modelled as
    uniform in the annulus of the reach, and the most likely annulus is the smallest one
    with all demonstrated points.
    """
    robot = labels.decision[:, 0].clamp(min=0)
    ends = torch.stack([labels.pick_pose[:, :2], labels.place_pose[:, :2]], 1)
    ends = ends.nan_to_num()
    drags = dragged(labels.decision[:, 1])[:, None]
    margins = seen.margins(ends)
    # At the end of a drag the gripper is low.
    held = seen.margins(ends[:, 1], low=True)
    margins = torch.stack(
        [margins[..., 0], torch.where(drags, held, margins[..., 1])], -1
    )
    logs = F.logsigmoid(margins / _REACH_EDGE_M).sum(-1)
    rows = torch.arange(len(robot), device=robot.device)
    likely = logs.log_softmax(1)[rows, robot] + logs[rows, robot]
    acts = labels.decision[:, 0] != NOBODY
    unlikely = torch.where(acts, -likely, 0.0).sum() / acts.sum().clamp(min=1)
    area = seen.radii[..., 1:].square() - seen.radii[..., :1].square()
    return _DEMONSTRATED * (unlikely + _TIGHT * area.log().mean())
