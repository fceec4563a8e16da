"""A check that a policy uses the conventions of the benchmark.

A policy that mirrors yaw, uses millimeters, another order of quaternions or exchanges
the robots runs without an error and fails every episode. Its first decision in a known
scene shows the mistake; docs/serving.md has the scene and the right decision. At
control level the scene is one second after the start of the expert: one arm is moving
to a cube with open fingers, and the other stands still, so a valid command is near the
present state.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from lemma.core.poses import FloatArray
from lemma.core.robot_names import robot_number
from lemma.env.base_env import EnvSnapshot
from lemma.env.camera_rig import CameraRig
from lemma.env.control.modes import CONTROLS
from lemma.env.control.pose_controllers import (
    DeltaPoseController,
    PoseController,
    WaypointController,
)
from lemma.env.control_env import ControlEnv
from lemma.env.episode import Episode
from lemma.evaluation.run.control import ControlPlayer, ControlRollout
from lemma.evaluation.run.fault_isolation import Fault, IsolatedPolicy
from lemma.evaluation.run.loading import connected
from lemma.evaluation.run.rollout import Rollout
from lemma.expert.expert import Expert
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.symbolic_state import SymbolicState
from lemma.policies.control.interfaces import chunk_of, has_options
from lemma.policies.spec import PolicySpec
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.serve.faults import FaultKind, PolicyFailedError
from lemma.tasks.subtask import GroundedSubTask, SubTask
from lemma.tasks.suite import load_instance

SCENE = ("stack", "val", 3)
"""Task, split and index. Each robot reaches only one of the two cubes, and their sides
are far from parallel to the axes."""
NEAR_M = 0.03
NEAR_RAD = 0.2


AFTER_S = 1.0
"""Time of the check at control level [s]."""
FAR_RAD, FAR_M, FAR_TURN_RAD = 0.5, 0.3, 1.0
"""Distances from the present state that no valid command has: of a joint [rad], of a
hand [m], and of its rotation [rad]."""
_LEAST_STEP = 1e-3
_AWAY = -0.3
"""Cosine of the angle to the cube below which a step leads away from it."""


@dataclass(frozen=True)
class ServerCheck:
    """A policy's decision in the known scene."""

    instruction: str
    answer: dict[str, Any]
    """Sub-task and poses as plain data; at control level, the first action by names of
    its numbers."""
    mistakes: dict[str, str]
    """Mistakes by ``pick``, ``robot`` and ``heading``; at control level by ``layout``,
    ``gripper`` and ``direction``."""

    @property
    def ok(self) -> bool:
        """Whether there are no mistakes."""
        return not self.mistakes


def first_subtask() -> SubTask:
    """Return the first sub-task of the expert in the known scene."""
    instance = load_instance(*SCENE)
    subtask, _ = Expert(Episode(instance).simulation.scene, instance.goal).act()
    return subtask


def check_server(url: str, arguments: tuple[tuple[str, Any], ...] = ()) -> ServerCheck:
    """Check a served policy in the known scene of its level.

    Args:
        url: Such as ``"http://127.0.0.1:8000"``, or the address of a model server.
        arguments: Names and values of the environment of a model server.

    Raises:
        InvalidConfigError: The address is invalid.
        PolicyUnreachableError: The server does not answer.
        ProtocolError: The server has another protocol.
        PolicyFailedError: The policy has no decision, or an invalid one.
        RenderingError: OpenGL does not work here.
    """
    part = connected(PolicySpec(url, arguments=arguments), url)
    try:
        return check_control(part) if has_options(part) else _check_decision(part)
    finally:
        part.close()


def _check_decision(part: Any) -> ServerCheck:
    """Check the first decision of a policy, planner or grounder in the known scene."""
    play = Rollout(load_instance(*SCENE))
    policy_input = play.policy_input(CameraRig())
    subtask, grounded = first_subtask(), None
    if hasattr(part, "act"):
        [decision] = part.act([policy_input])
        subtask, grounded = decision.subtask, decision.grounded
    else:
        if hasattr(part, "plan"):
            [subtask] = part.plan([policy_input])
        if hasattr(part, "ground") and subtask.robot:
            [grounded] = part.ground([policy_input], [subtask])
    poses = None if grounded is None else grounded.to_dict()
    answer = {"subtask": subtask, "grounded": poses}
    found = _decision_mistakes(play, subtask, grounded)
    return ServerCheck(policy_input.instruction, answer, found)


def _decision_mistakes(
    play: Rollout, subtask: SubTask, grounded: GroundedSubTask | None
) -> dict[str, str]:
    """Return the mistakes of a first decision."""
    now = SymbolicState.observe(play.episode.simulation.scene)
    geometry = GeometricGrounder(now.spec)
    [pair] = play.instance.goal.pairs
    cubes = {name: now.poses[name] for name in pair}
    places = ", ".join(f"{n} at ({p.x:.3f}, {p.y:.3f}) m" for n, p in cubes.items())
    if grounded is None:
        picked = subtask.pick
        if picked not in cubes:
            return {"pick": f"It picks {picked or 'nothing'}; there are {places}."}
    else:
        at = grounded.pick
        picked = min(cubes, key=lambda name: cubes[name].distance(at))
        if cubes[picked].distance(at) > NEAR_M:
            return {"pick": f"It picks at ({at.x:g}, {at.y:g}); there are {places}."}
    found = {}
    [able] = [r for r in geometry.robots if geometry.reaches(r, cubes[picked])]
    if subtask.robot != able:
        found["robot"] = f"It sends {subtask.robot}; {able} alone reaches {picked}."
    if grounded is not None:
        # A cube is symmetric under quarter turns.
        off = math.remainder(grounded.pick.yaw - cubes[picked].yaw, 0.5 * math.pi)
        if abs(off) > NEAR_RAD:
            found["heading"] = (
                f"Its gripper is {abs(math.degrees(off)):.0f} degrees off the sides of "
                f"{picked}, whose yaw is {cubes[picked].yaw:.3f} rad."
            )
    return found


def check_control(policy: Any) -> ServerCheck:
    """Check the first action of a policy at control level in the known scene.

    Args:
        policy: See :class:`lemma.policies.control.interfaces.ControlPolicy`.

    Raises:
        PolicyFailedError: The policy has no action, or an invalid one.
        PolicyUnreachableError: The server does not answer.
        RenderingError: OpenGL does not work here.
    """
    player = ControlPlayer(policy)
    rollout = player.begin(load_instance(*SCENE), "high_level")
    assert isinstance(rollout, ControlRollout)
    robot, cube = _set_out(rollout.env)
    control_input = player.policy_input(rollout)
    [answer] = IsolatedPolicy(policy).decide([control_input])
    if isinstance(answer, Fault):
        raise PolicyFailedError(answer.kind, answer.explanation)
    layout = rollout.env.action_layout
    try:
        rows = np.asarray(chunk_of(answer.rows, layout.shape)[0], np.float64)
    except ValueError as error:
        raise PolicyFailedError(FaultKind.MALFORMED, f"{error}.") from error
    names = [f"{row}.{column}" for row in layout.rows for column in layout.columns]
    action = {
        name: round(value, 4)
        for name, value in zip(names, rows.ravel().tolist(), strict=True)
    }
    found = mistakes(rollout.env, rows, robot, cube)
    return ServerCheck(control_input.instruction, {"action": action}, found)


def _set_out(env: ControlEnv) -> tuple[int, str]:
    """Run the expert's start; return the moving robot's number and its cube."""
    episode = Episode(env.instance)
    scene = episode.simulation.scene
    subtask, grounded = Expert(scene, env.instance.goal).act()
    assert grounded is not None
    episode.simulation.execute(grounded, until_s=AFTER_S)
    env.restore(EnvSnapshot(episode.snapshot(), {"settled_s": 0.0}))
    return robot_number(subtask.robot), subtask.pick


def mistakes(
    env: ControlEnv, rows: FloatArray, robot: int, cube: str
) -> dict[str, str]:
    """Return the mistakes of an action in the known scene.

    Args:
        env: Environment in the state of the check.
        rows: The action, (robots, numbers).
        robot: Number of the moving robot.
        cube: Name of the cube to which it moves.
    """
    found = {}
    jump = _jump(env, rows)
    if jump >= 1.0:
        found["layout"] = _layout(env, rows)
    name, opening = env.robot_names[robot], rows[robot, -1]
    delta = issubclass(CONTROLS[env.config.control].controller, DeltaPoseController)
    if (opening + 1.0) / 2.0 < 0.5 if delta else opening < 0.5 * FINGER_OPENING_M:
        found["gripper"] = (
            f"It closes the fingers of {name} ({opening:g}) on the way to {cube}. Here "
            + ("-1 is closed and 1 open." if delta else "it is an opening in metres.")
        )
    elif not delta and opening > FINGER_OPENING_M + 1e-6:
        found["gripper"] = (
            f"It opens the fingers of {name} to {opening:g} m; the widest is "
            f"{FINGER_OPENING_M:g} m. Is it a fraction, or millimetres?"
        )
    if delta:
        found.update(_direction(env, rows, robot, cube))
    return found


def _direction(
    env: ControlEnv, rows: FloatArray, robot: int, cube: str
) -> Mapping[str, str]:
    scene = env.episode.simulation.scene
    at = _poses(env)[robot, :2]
    wanted = scene.pose_row(cube)[:2] - at
    lengths = np.linalg.norm(rows[:, :2], axis=1) * math.hypot(*wanted)
    cosines = rows[:, :2] @ wanted / np.maximum(lengths, 1e-12)
    others = [n for n, cosine in enumerate(cosines) if n != robot and cosine > -_AWAY]
    stands = math.hypot(*rows[robot, :2]) < _LEAST_STEP
    if cosines[robot] > _AWAY and not (stands and others):
        return {}
    hint = "Are the robots in the other order?" if others else "Are signs the same?"
    return {
        "direction": f"It moves {env.robot_names[robot]} by "
        f"({rows[robot, 0]:.2g}, {rows[robot, 1]:.2g}), but {cube} lies "
        f"({wanted[0]:.2f}, {wanted[1]:.2f}) m from its hand in the world frame. {hint}"
    }


def _jump(env: ControlEnv, rows: FloatArray) -> float:
    """Return the distance of an action from the present state; above 1 is too far.

    It is 0 for relative steps, and for waypoints, which are the ends of motions.
    """
    mode = CONTROLS[env.config.control]
    if env.config.control == "joint_position":
        joints = env.observe()["agent_pos"].reshape(len(rows), 7)
        return float(np.abs(rows[:, :6] - joints[:, :6]).max()) / FAR_RAD
    driver = mode.controller
    anywhere = (DeltaPoseController, WaypointController)
    if issubclass(driver, anywhere) or not issubclass(driver, PoseController):
        return 0.0
    worst = 0.0
    for row, pose in zip(rows, _poses(env), strict=True):
        turned = driver.rotation.quaternion(row[3:-1].tolist())
        cosine = 0.0 if turned is None else abs(float(np.dot(turned, pose[3:])))
        angle = 2.0 * math.acos(min(1.0, cosine))
        far = math.dist(row[:3], pose[:3]) / FAR_M
        worst = max(worst, far, angle / FAR_TURN_RAD)
    return worst


def _layout(env: ControlEnv, rows: FloatArray) -> str:
    """Return a sentence with another interpretation of an action that is too far."""
    for reading, other in _readings(env, rows):
        if _jump(env, other) < 1.0:
            return f"It leads far from where the arms are, but not if {reading}."
    return (
        "It leads far from where the arms are at once. Are units, frame and order "
        "those of docs/vla_eval.md?"
    )


def _readings(env: ControlEnv, rows: FloatArray) -> Iterator[tuple[str, FloatArray]]:
    columns = env.action_layout.columns
    yield "the robots are in the other order", rows[::-1]
    flat, arms = rows.ravel(), len(columns) - 1
    split = flat[: len(rows) * arms].reshape(len(rows), arms)
    grippers = flat[len(rows) * arms :, None]
    yield "both arms come first and both grippers last", np.hstack([split, grippers])
    if "qw" in columns:
        order = [0, 1, 2, 6, 3, 4, 5, 7]
        yield "quaternions are xyzw, and here they are wxyz", rows[:, order]
    if "x" not in columns:
        yield (
            "angles are degrees, and here they are radians",
            np.hstack([np.deg2rad(rows[:, :6]), rows[:, 6:]]),
        )
        return
    yield "positions are millimetres", np.hstack([rows[:, :3] / 1000.0, rows[:, 3:]])
    based = rows.copy()
    for row, robot in zip(based, env.instance.scene.robots, strict=True):
        base, (x, y) = robot.base, row[:2].copy()
        row[0] = base.x + math.cos(base.yaw) * x - math.sin(base.yaw) * y
        row[1] = base.y + math.sin(base.yaw) * x + math.cos(base.yaw) * y
    yield "positions are in the frame of each robot's base", based


def _poses(env: ControlEnv) -> FloatArray:
    """Return the hands' poses: position [m] and quaternion wxyz, (robots, 7)."""
    rows = env.observe()["tcp_pose"].reshape(-1, 7)
    return np.asarray(rows, np.float64)
