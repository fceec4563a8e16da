"""A new kind of object, a can, in a new color, and a task with it.

python examples/11_write_an_object.py [SEED]
"""

import sys

import lemma
from lemma.scene.objects.kind import cylinder
from lemma.tasks.goal import Goal, On
from lemma.tasks.placement import ObjectPlacer

CAN = lemma.OBJECT_KINDS.add(
    "can",
    cylinder("can", radius_m=0.03, height_m=0.08, mass_kg=0.15, nouns=("can", "tin")),
)
lemma.OBJECT_COLORS.add("purple", (0.45, 0.20, 0.60, 1.0))


def arrange(placer: ObjectPlacer) -> Goal:
    """Give one robot a can, the other a pad and a cube, and return the goal."""
    giver, taker = placer.order
    can = placer.put("can", placer.only(giver), color="purple")
    pad = placer.pad(placer.only(taker))
    cube = placer.cube(placer.only(taker))
    return Goal((On(can, pad), On(cube, can)))


lemma.TASKS.add(
    "can_stack",
    lemma.Task(
        name="can_stack",
        summary="One robot hands a can over, the other puts it on a pad and tops it.",
        subtasks=3,
        distractors=(0, 2),
        arrange=arrange,
        language=lemma.LanguageBank.from_strings(
            high_level=[
                "Place the {top1} on the {bottom1} and the {top2} on the {bottom2}"
            ],
            human=["stand the {top1} on the {bottom1}, then {top2} on the {bottom2}"],
            unseen=["The {bottom1} gets the {top1}, and the {bottom2} the {top2}."],
        ),
    ),
)

if __name__ == "__main__":
    seed = int(sys.argv[1]) if len(sys.argv) > 1 else 0
    env = lemma.make("can_stack", level="plan", split="free", index=seed)
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
