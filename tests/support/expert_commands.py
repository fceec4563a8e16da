"""The expert's motion as joint positions at 20 Hz: a policy that succeeds."""

import numpy as np
from numpy.typing import NDArray

from lemma.env.episode import Episode
from lemma.expert.expert import Expert, solve
from lemma.scene.build import TICK_S
from lemma.tasks.suite import load_instance

HZ = 20


def expert_commands(task: str, split: str, index: int) -> NDArray[np.float32]:
    """Return what the expert's servos are led to, (steps, 14)."""
    episode = Episode(load_instance(task, split, index))
    simulation = episode.simulation
    rows: list[list[float]] = []

    def note() -> None:
        openings = simulation.scene.data.ctrl
        rows.append(
            [
                number
                for arm in simulation.arms.values()
                for number in (*arm.state[0], openings[arm.robot.gripper_ctrl])
            ]
        )

    simulation.observers.append(note)
    for _ in solve(episode, Expert(simulation.scene, episode.instance.goal)):
        pass
    stride = round(1.0 / (HZ * TICK_S))
    return np.array([*rows[stride - 1 :: stride], rows[-1]], np.float32)
