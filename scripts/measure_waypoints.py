"""Measure the errors of a policy's waypoints, before and after arms begin to move.

    python scripts/train_lerobot_policy.py film data/recipe /tmp/val --split val
    python scripts/measure_waypoints.py /tmp/val CHECKPOINT

A policy that infers the target from an arm's motion instead of the images has large
errors in the first frames of an episode and small ones later. The policy gets the
observations of the demonstrations, without a simulation.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.policies import get_policy_class, make_pre_post_processors
from lerobot.utils.constants import ACTION

from demonstration_film import ROBOTS, Film
from lemma.env.learning.motor_state import MOTORS, WAYPOINT
from lemma.policies.control.checkpoint_file import checkpoint_folder

FRAMES = (0, 1, 2, 3, 5, 8)
"""Numbers of frames after the start of an episode."""
SHARES = (0.25, 0.5, 0.75)


@torch.no_grad()
def errors_m(film: Film, checkpoint: str) -> dict[int, torch.Tensor]:
    """Return the horizontal error of the worse robot's waypoint, by frame.

    Args:
        film: The rendered demonstrations.
        checkpoint: A folder, or the name of published weights.

    Returns:
        (episodes,) [m] for each of :data:`FRAMES`.
    """
    with checkpoint_folder(checkpoint) as folder:
        config = PreTrainedConfig.from_pretrained(folder)
        config.device = "cpu"
        policy = get_policy_class(config.type).from_pretrained(folder, config=config)
        before, after = make_pre_post_processors(
            config,
            pretrained_path=folder,
            preprocessor_overrides={"device_processor": {"device": "cpu"}},
        )
    policy.eval()
    torch.manual_seed(0)
    found = {}
    for frame in FRAMES:
        index = (film.begins() + frame).minimum(film.last.unique())
        batch = before(film.samples(index, config))
        aimed = after(policy.predict_action_chunk(batch))[:, 0]
        off = aimed - film.vectors[ACTION][index]
        over_table = off.reshape(len(off), ROBOTS, len(MOTORS[WAYPOINT]))[..., :2]
        found[frame] = over_table.norm(dim=2).amax(1)
    return found


def main(words: Sequence[str] | None = None) -> None:
    """Print errors frame by frame."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("film", type=Path)
    parser.add_argument("checkpoint")
    asked = parser.parse_args(words)
    errors = errors_m(Film.load(asked.film, "cpu"), asked.checkpoint)
    print("frame  waypoint off [cm]: a quarter, half, three quarters of the episodes")
    for frame, off in errors.items():
        cm = 100.0 * off.quantile(torch.tensor(SHARES))
        print(f"{frame:5d}  {'  '.join(f'{value:5.1f}' for value in cm.tolist())}")


if __name__ == "__main__":
    main()
