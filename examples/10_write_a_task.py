"""A new task: the first robot's cube goes onto the other's pad, the other's on top.

python examples/10_write_a_task.py [SEED]
"""

import sys

import lemma
from lemma.tasks.goal import Goal, On
from lemma.tasks.placement import ObjectPlacer


def arrange(placer: ObjectPlacer) -> Goal:
    """Place the objects in the robots' zones, and return the goal."""
    giver, builder = placer.order
    lower = placer.cube(placer.only(giver))
    upper = placer.cube(placer.only(builder))
    pad = placer.pad(placer.only(builder))
    return Goal((On(lower, pad), On(upper, lower)))


lemma.TASKS.add(
    "pile",
    lemma.Task(
        name="pile",
        summary="One robot hands a cube over, the other builds a tower on its pad.",
        subtasks=3,
        distractors=(0, 2),
        arrange=arrange,
        language=lemma.LanguageBank.from_strings(
            high_level=[
                "Place the {top1} on the {bottom1} and the {top2} on the {bottom2}"
            ],
            human=["build a tower: {top1} on the {bottom1}, then {top2} on {bottom2}"],
            unseen=["Let the {top2} crown the {bottom2} once {top1} is on {bottom1}."],
        ),
    ),
)

if __name__ == "__main__":
    seed = int(sys.argv[1]) if len(sys.argv) > 1 else 0
    env = lemma.make("pile", level="plan", split="free", index=seed)
    expert = lemma.ExpertPolicy(env)
    observation, info = env.reset()
    print(info["instruction"])
    done = False
    while not done:
        action = expert.act(observation)
        observation, reward, terminated, truncated, info = env.step(action)
        done = terminated or truncated
    print(f"{'success' if reward else 'failure'} after {info['elapsed_s']:.1f} s")
    sys.exit(reward != 1.0)
