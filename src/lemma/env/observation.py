"""Observations: joints and the instruction, and cameras or the true state."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from lemma.core.poses import FloatArray, quaternion_from_matrix, wrap
from lemma.core.registry import Registry
from lemma.core.robot_names import robot_name
from lemma.env.camera_rig import CameraRig
from lemma.env.episode import Episode
from lemma.env.signals.goal_state import goal_state, goal_state_names
from lemma.env.view import View
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.robots.reach import reach_of
from lemma.robots.ur.build import ARMS
from lemma.scene.objects.entity import HAND, known_entities
from lemma.scene.proprioception import Proprioception
from lemma.scene.raster import CEILING_M, RASTER
from lemma.scene.scene import Scene
from lemma.scene.spec import SceneSpec
from lemma.tasks.goal import Goal
from lemma.tasks.language.blind import instruction

Observation = dict[str, Any]

MAX_INSTRUCTION_LENGTH = 200
_JOINT_SLACK_RAD = 0.1
_JOINT_SPEED_RAD_S = 10.0
_FINGER_SPEED_M_S = 1.0
_ROOM_M = 10.0
_LARGEST_DEPTH_M = 100.0
_LARGEST_KG = 100.0


@dataclass(frozen=True, slots=True)
class Contents:
    """Contents of an observation beside joints and instruction."""

    rgb: bool = False
    """``pixels``: for each camera, (height, width, 3)."""
    depth: bool = False
    """``depth``: for each camera, (height, width) [m] in steps of 0.1 mm; 0 where
    nothing is seen."""
    topdown: bool = False
    """``map``: all cameras fused, from above; see :mod:`lemma.scene.raster`."""
    truth: bool = False
    """Poses of objects and robots, and the goal: privileged state."""
    goal: bool = False
    """``goal_state``: relation of each hand to the goal, from the true state; see
    :mod:`lemma.env.signals.goal_state`."""

    @property
    def renders(self) -> bool:
        """Whether OpenGL is needed."""
        return self.rgb or self.depth or self.topdown


OBSERVATIONS: Registry[Contents] = Registry("observation", Contents)
"""The modes of observation, by name."""
OBSERVATIONS.add("state", Contents())
OBSERVATIONS.add("rgb", Contents(rgb=True))
OBSERVATIONS.add("rgbd", Contents(rgb=True, depth=True))
OBSERVATIONS.add("map", Contents(topdown=True))
OBSERVATIONS.add("privileged", Contents(truth=True))
OBSERVATIONS.add("goal_state", Contents(goal=True))


TRUTH = ("objects", "present", "robots", "goal", "goal_poses")
"""Parts of the true state, in the order of :func:`truth_vector`."""
LOADS = ("masses_kg", "carries_kg")
"""Masses of all objects, and the largest mass that each robot carries: parts of the
true state that :func:`truth_vector` leaves out."""
POSE_AXES = ("x", "y", "z", "qw", "qx", "qy", "qz")
"""Numbers of a pose."""
GOAL_PAIRS = 4
"""Largest number of pairs in a goal, which sizes its array of poses."""
_BASE = ("base_x", "base_y", "base_yaw", "reach")


class Observer:
    """Makes observations for some of the robots of a team.

    ``agent_pos`` holds, for each robot, six joint angles [rad] and the opening of the
    gripper [m]; ``agent_vel`` their rates; ``tcp_pose`` the position [m] and unit
    quaternion (wxyz, w >= 0) of the tool centre point in the world; ``base_pose`` those
    of the robot's base, which stays where it is; ``instruction`` the instruction as
    ASCII codes, see :func:`read_text`.
    """

    def __init__(
        self,
        mode: str,
        robots: tuple[int, ...],
        size: tuple[int, int],
        cameras: tuple[str, ...] | None = None,
        kinds: Collection[str] = (),
    ) -> None:
        """Define the space; OpenGL starts with the first image.

        Args:
            mode: A name in :data:`OBSERVATIONS`.
            robots: Indices of the observed robots.
            size: Width and height of camera images [px].
            cameras: Names of the cameras; those of these robots if None.
            kinds: Kinds that only some tasks have; see :attr:`.Task.kinds`.

        Raises:
            UnknownNameError: No such mode.
            InvalidConfigError: Images of this size cannot be rendered.
        """
        self.contents = OBSERVATIONS[mode]
        self.rig = CameraRig(*size)
        self._proprioception: Proprioception | None = None
        self._bases = np.zeros(0, np.float32)
        self._robots = robots
        self._size = size
        self._names = tuple(map(robot_name, robots))
        self.cameras = self._names if cameras is None else cameras
        self._entities = known_entities(kinds)
        self.space = spaces.Dict(self._joints())
        for name, space in self._vision().items():
            self.space[name] = space
        if self.contents.truth:
            for name, space in self._truth().items():
                self.space[name] = space
        if self.contents.goal:
            most = np.full(len(goal_state_names(self._names)), _ROOM_M)
            self.space["goal_state"] = _box(-most, most)

    def _joints(self) -> dict[str, spaces.Space[Any]]:
        count = len(self._robots)
        turn = np.max([ARMS[name].joint_range for name in ARMS], axis=0)
        joints = [*(turn + _JOINT_SLACK_RAD), FINGER_OPENING_M]
        rates = [_JOINT_SPEED_RAD_S] * 6 + [_FINGER_SPEED_M_S]
        low = np.array([-joint for joint in joints[:6]] + [0.0])
        pose = [_ROOM_M] * 3 + [1.0] * 4
        return {
            "agent_pos": _box(np.tile(low, count), np.tile(joints, count)),
            "agent_vel": _box(-np.tile(rates, count), np.tile(rates, count)),
            "tcp_pose": _box(-np.tile(pose, count), np.tile(pose, count)),
            "base_pose": _box(-np.tile(pose, count), np.tile(pose, count)),
            "instruction": spaces.Box(0, 127, (MAX_INSTRUCTION_LENGTH,), np.uint8),
        }

    def _vision(self) -> dict[str, spaces.Space[Any]]:
        width, height = self._size
        found: dict[str, spaces.Space[Any]] = {}
        if self.contents.rgb:
            image = spaces.Box(0, 255, (height, width, 3), np.uint8)
            found["pixels"] = spaces.Dict(dict.fromkeys(self.cameras, image))
        if self.contents.depth:
            depth = spaces.Box(0.0, _LARGEST_DEPTH_M, (height, width), np.float32)
            found["depth"] = spaces.Dict(dict.fromkeys(self.cameras, depth))
        if self.contents.topdown:
            shape = (RASTER.rows, RASTER.columns)
            ends = RASTER.encode_height((RASTER.floor_m, CEILING_M), np.ones(2, bool))
            low, high = RASTER.decode_height(ends).tolist()
            found["map"] = spaces.Dict(
                {
                    "rgb": spaces.Box(0, 255, (*shape, 3), np.uint8),
                    "height_m": spaces.Box(low, high, shape, np.float32),
                    "coverage": spaces.MultiBinary(list(shape)),
                }
            )
        return found

    def _truth(self) -> dict[str, spaces.Space[Any]]:
        count = len(self._entities)
        pose = np.tile([_ROOM_M] * 3 + [1.0] * 4, (count, 1))
        base = np.tile([_ROOM_M, _ROOM_M, np.pi, _ROOM_M], (len(self._robots), 1))
        kilograms = (np.full(n, _LARGEST_KG) for n in (count, len(self._robots)))
        loads = {k: _box(0.0 * m, m) for k, m in zip(LOADS, kilograms, strict=True)}
        return loads | {
            "objects": _box(-pose, pose),
            "present": spaces.MultiBinary(count),
            "robots": _box(-base, base),
            "goal": spaces.MultiBinary([count, count]),
            "goal_poses": _box(
                *(sign * np.resize(pose[0], (GOAL_PAIRS, 2, 7)) for sign in (-1, 1))
            ),
        }

    def observe(self, episode: Episode, kind: str) -> Observation:
        """Return the observation of an episode's present state.

        Args:
            episode: The episode.
            kind: Kind of the instruction.

        Raises:
            RenderingError: Images are observed, and OpenGL does not work here.
        """
        scene = episode.simulation.scene
        if self._proprioception is None or self._proprioception.scene is not scene:
            boxes = [
                self.space[name] for name in ("agent_pos", "agent_vel", "tcp_pose")
            ]
            low, high = (
                np.concatenate([getattr(box, end) for box in boxes])
                for end in ("low", "high")
            )
            self._proprioception = Proprioception(scene, self._names, low, high)
            self._bases = self._locate_bases(scene)
        joints, rates, poses = self._proprioception.measure()
        found: Observation = {
            "agent_pos": joints,
            "agent_vel": rates,
            "tcp_pose": poses,
            "base_pose": self._bases.copy(),
            "instruction": write_text(instruction(episode.instance, kind)),
        }
        if self.contents.renders:
            found.update(self._see(self.view(scene)))
        if self.contents.truth:
            objects = object_poses(scene)
            found.update(self.truth(objects, scene.spec, episode.instance.goal))
        if self.contents.goal:
            found["goal_state"] = self._fit(
                "goal_state", goal_state(episode, self._names)
            )
        return found

    def _locate_bases(self, scene: Scene) -> NDArray[np.float32]:
        robots = [scene.robot(name) for name in self._names]
        rows = [
            (*pose[:3, 3], *quaternion_from_matrix(pose[:3, :3]))
            for pose in (robot.world_from_base for robot in robots)
        ]
        return self._fit("base_pose", np.ravel(rows))

    def view(self, scene: Scene) -> View:
        """Return the present view of a policy."""
        return self.rig.look(scene, self._names, self.cameras)

    def close(self) -> None:
        """Free the resources of rendering."""
        self.rig.close()

    def _see(self, view: View) -> Observation:
        found: Observation = {}
        if self.contents.rgb:
            found["pixels"] = {name: view.cameras[name].rgb for name in self.cameras}
        if self.contents.depth:
            found["depth"] = {name: view.cameras[name].depth_m for name in self.cameras}
        if self.contents.topdown:
            found["map"] = {
                "rgb": view.rgb,
                "height_m": view.height_m,
                "coverage": view.coverage.astype(np.int8),
            }
        return found

    def truth(
        self, poses: Mapping[str, FloatArray], spec: SceneSpec, goal: Goal
    ) -> Observation:
        """Return the true state, for privileged observers.

        Args:
            poses: Poses of every object, see :func:`object_poses`.
            spec: The scene.
            goal: The goal.
        """
        number = {name: i for i, name in enumerate(self._entities)}
        objects = np.zeros((len(number), 7))
        present = np.zeros(len(number), np.int8)
        wanted = np.zeros((len(number), len(number)), np.int8)
        for name, pose in poses.items():
            objects[number[name]] = pose
            present[number[name]] = 1
        masses = np.zeros(len(number))
        for placed in spec.objects:
            # Also of objects that have fallen off the table.
            masses[number[placed.name]] = placed.weight_kg
        asked = np.zeros((GOAL_PAIRS, 2, 7))
        for pair, (top, bottom) in enumerate(goal.pairs):
            # A hand has neither an index nor a pose. In the table, the object's pose
            # stands for it; zeros in the pair mark which of the two is the hand.
            there = [name for name in (top, bottom) if name != HAND]
            wanted[number[there[0]], number[there[-1]]] = 1
            if pair < GOAL_PAIRS:
                for side, name in enumerate((top, bottom)):
                    if name != HAND:
                        asked[pair, side] = poses[name]
        robots = [spec.robots[i] for i in self._robots]
        bases = [
            [r.base.x, r.base.y, wrap(r.base.yaw), reach_of(r.arm).travel_m]
            for r in robots
        ]
        return {
            "objects": self._fit("objects", objects),
            "present": present,
            "robots": self._fit("robots", bases),
            "goal": wanted,
            "goal_poses": self._fit("goal_poses", asked),
            "masses_kg": self._fit("masses_kg", masses),
            "carries_kg": self._fit("carries_kg", [r.carries_kg for r in robots]),
        }

    def _fit(self, name: str, values: Any) -> NDArray[np.float32]:
        """Return values in the dtype of their space, clipped to its bounds."""
        space = self.space[name]
        assert isinstance(space, spaces.Box)
        array = np.asarray(values, np.float32)
        clipped: NDArray[np.float32] = np.clip(array, space.low, space.high)
        return clipped


def truth_vector(observation: Mapping[str, Any]) -> NDArray[np.float32]:
    """Return the true state in an observation as one vector, by :data:`TRUTH`.

    For two robots and the built-in objects it has 273 numbers.
    """
    rows = [np.ravel(observation[part]) for part in TRUTH]
    return np.concatenate(rows).astype(np.float32)


def truth_names(robots: Sequence[str], kinds: Collection[str] = ()) -> list[str]:
    """Return the name of each number of :func:`truth_vector` for a team.

    Args:
        robots: Names of the robots.
        kinds: Kinds that only some tasks have; see :attr:`.Task.kinds`.
    """
    entities = known_entities(kinds)
    return [
        *(f"{name}.{axis}" for name in entities for axis in POSE_AXES),
        *(f"{name}.present" for name in entities),
        *(f"{robot}.{number}" for robot in robots for number in _BASE),
        *(f"{top}.on.{bottom}" for top in entities for bottom in entities),
        *(
            f"goal_{pair}.{end}.{axis}"
            for pair in range(GOAL_PAIRS)
            for end in ("top", "bottom")
            for axis in POSE_AXES
        ),
    ]


def write_text(text: str) -> NDArray[np.uint8]:
    """Return a text as ASCII codes, padded with zeros.

    Gymnasium's own text space does not work with vector environments that share memory:
    their observations never change.
    """
    return _codes(text).copy()


@lru_cache
def _codes(text: str) -> NDArray[np.uint8]:
    codes = np.zeros(MAX_INSTRUCTION_LENGTH, np.uint8)
    codes[: len(text)] = np.frombuffer(text.encode("ascii"), np.uint8)
    return codes


def read_text(codes: NDArray[np.uint8]) -> str:
    """Return the text that :func:`write_text` wrote."""
    return bytes(codes[codes > 0]).decode("ascii")


def object_poses(scene: Scene) -> dict[str, FloatArray]:
    """Return the true pose of every object: position [m] and quaternion wxyz, (7,)."""
    return scene.pose_rows()


def _box(low: Any, high: Any) -> spaces.Box:
    return spaces.Box(
        np.asarray(low, np.float32), np.asarray(high, np.float32), dtype=np.float32
    )
