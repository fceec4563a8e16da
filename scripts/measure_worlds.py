"""Measure differences between the GPU's worlds and the CPU, as JSON per task.

python scripts/measure_worlds.py [WORLDS] [TASK ...]

The expert's motor commands are replayed in many worlds; except in the first one, the
objects' initial positions differ by up to a millimeter. Then the worlds are set to
states of the expert's episode, to compare rewards and observations. `lemma bench --gpu`
measures speed.
"""

import json
import sys
from dataclasses import dataclass, field
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
from numpy.typing import NDArray

import lemma
from lemma.core.poses import FloatArray
from lemma.env.episode import Episode
from lemma.env.signals.goal_state import NUMBERS, goal_state
from lemma.env.signals.rewards import goal_potential
from lemma.warp.graphs import launched
from lemma.warp.vector_env import GpuVecEnv

EVERY = 50
"""Physics steps between two compared states."""
NEAR_M = 0.015
TASKS = ("reach", "lift", "place", "hand_over", "pass", "stack", "pass2", "stack2")


@dataclass
class Played:
    """An episode of the expert on the CPU."""

    episode: Episode
    begin: FloatArray
    commands: list[FloatArray] = field(default_factory=list)
    """Control inputs of the motors in each physics step."""
    states: list[tuple[FloatArray, FloatArray, float, NDArray[np.float32]]] = field(
        default_factory=list
    )
    """Every :data:`EVERY` steps: positions, velocities, potential, goal state."""

    def look(self) -> None:
        """Record the state after a servo tick, if it is time."""
        data = self.episode.simulation.scene.data
        if len(self.commands) % EVERY == 0:
            robots = self.episode.instance.scene.robot_names
            goal = goal_potential(self.episode), goal_state(self.episode, robots)
            self.states.append((data.qpos.copy(), data.qvel.copy(), *goal))


def play(instance: Any) -> Played:
    """Solve an instance with the expert, and record the episode."""
    episode = Episode(instance)
    scene = episode.simulation.scene
    played = Played(episode, scene.data.qpos.copy())
    episode.simulation.observers.append(played.look)
    mujoco.set_mjcb_control(lambda _, data: played.commands.append(data.ctrl.copy()))
    try:
        list(lemma.solve(episode, lemma.Expert(scene, episode.instance.goal)))
    finally:
        mujoco.set_mjcb_control(None)
    return played


class Slots:
    """Map from the CPU's joints to those of the GPU's model, which has more objects."""

    def __init__(self, env: GpuVecEnv, played: Played) -> None:
        """Match movable objects by their initial positions."""
        ours = played.episode.simulation.scene
        theirs, begin = env.pool.scene, env.pool.rows["qpos"][0]
        self.names: dict[str, int] = {}
        self._pairs, self._rates = [], []
        for name in ours.movable_names:
            at = ours.qpos_of(name)
            there = min(
                theirs.movable_names,
                key=lambda k: float(
                    np.hypot(*(begin[theirs.qpos_of(k) :][:2] - played.begin[at:][:2]))
                ),
            )
            self.names[name] = theirs.qpos_of(there)
            self._pairs.append((slice(at, at + 7), self._span(theirs.qpos_of(there))))
            a, b = (
                int(s.model.joint(n).dofadr[0])
                for s, n in ((ours, name), (theirs, there))
            )
            self._rates.append((slice(a, a + 6), slice(b, b + 6)))
        for robot, other in zip(ours.robots, theirs.robots, strict=True):
            last = slice(robot.qpos.start, robot.qpos.stop + 2)
            self._pairs.append((last, slice(other.qpos.start, other.qpos.stop + 2)))
            rate = slice(robot.dof.start, robot.dof.stop + 2)
            self._rates.append((rate, slice(other.dof.start, other.dof.stop + 2)))

    @staticmethod
    def _span(at: int) -> slice:
        return slice(at, at + 7)

    def put(self, env: GpuVecEnv, world: Any, qpos: FloatArray, qvel: Any) -> None:
        """Set the state of some worlds."""
        for ours, theirs in self._pairs:
            env.qpos[world, theirs] = torch.tensor(qpos[ours]).to(env.qpos)
        for ours, theirs in self._rates:
            env.qvel[world, theirs] = torch.tensor(qvel[ours]).to(env.qvel)


def agreement(task: str, worlds: int, device: str | None = None) -> dict[str, Any]:
    """Return the differences between many worlds and the CPU.

    Returns:
        ``objects``: for each, the median distance between its final positions [mm], and
        the share of worlds with less than 15 mm; ``success`` on the CPU, and its share
        in the worlds; ``potential`` and ``goal_state``: median and largest difference
        in equal states.
    """
    env = GpuVecEnv(task, worlds, pool=1, control_hz=100.0, seed=7, device=device)
    env.reset()
    played = play(env.pool.instances[0])
    slots = Slots(env, played)
    slots.put(env, slice(None), played.begin, np.zeros(len(env.qvel[0])))
    for at in slots.names.values():
        env.qpos[1:, at : at + 2] += 0.001 * (torch.rand_like(env.qpos[1:, :2]) - 0.5)
    replay(env, played.commands)
    scene = played.episode.simulation.scene
    objects = {}
    for name, at in slots.names.items():
        end = torch.tensor(scene.position(name)).to(env.qpos)
        off = torch.linalg.vector_norm(env.qpos[:, at : at + 3] - end, dim=1)
        near = float((off < NEAR_M).float().mean())
        objects[name] = (1e3 * float(off.median()), near)
    found = {
        "task": task,
        "worlds": worlds,
        "objects": objects,
        "success": (played.episode.is_success, share(env)),
    }
    env.check()
    return found | compare_states(env, slots, played)


def look(env: GpuVecEnv) -> None:
    """Update the signals from the present states of the worlds."""
    launched(env._note_touches, env.device)()
    env._place_hands()
    env.signals.look()


def share(env: GpuVecEnv) -> float:
    """Return the share of worlds in which the goal holds."""
    look(env)
    return float(env.signals.succeeds().float().mean())


def replay(env: GpuVecEnv, log: list[FloatArray]) -> None:
    """Run the same motor commands in all worlds."""
    commands = torch.tensor(np.array(log), dtype=torch.float32, device=env.device)
    env.ctrl[:] = commands[0]
    step = launched(lambda: mjw.step(env.model, env.data), env.device)
    # On a GPU, recording the graph has executed one step.
    for row in commands[1:] if env.device.startswith("cuda") else commands:
        env.ctrl[:] = row
        step()


def compare_states(env: GpuVecEnv, slots: Slots, played: Played) -> dict[str, Any]:
    """Return differences of potentials and goal states in equal states."""
    off: dict[str, list[float]] = {"potential": [], "goal_state": []}
    forward = launched(lambda: mjw.forward(env.model, env.data), env.device)
    for first in range(0, len(played.states), env.num_envs):
        part = played.states[first : first + env.num_envs]
        for world, (qpos, qvel, _, _) in enumerate(part):
            slots.put(env, world, qpos, qvel)
        forward()
        look(env)
        potentials = env.signals.potential().tolist()
        goals = env.signals.goal_state(env.opening).flatten(1).cpu().numpy()
        for world, (_, _, potential, goal) in enumerate(part):
            off["potential"].append(abs(potentials[world] - potential))
            ours = np.asarray(goal).reshape(-1, len(NUMBERS))
            theirs = goals[world].reshape(ours.shape)
            off["goal_state"].append(float(np.abs(ours - theirs).max()))
    return {key: (float(np.median(v)), max(v)) for key, v in off.items()}


if __name__ == "__main__":
    arguments = sys.argv[1:]
    worlds = int(arguments[0]) if arguments else 1024
    for each in arguments[1:] or TASKS:
        print(json.dumps(agreement(each, worlds)), flush=True)
