"""An attack of one's own: put every cube as near to its goal as one arm can.

lemma --plugin examples/14_write_an_attack.py audit --attacks set_down_near
"""

import math

from lemma.audit.attack import ATTACKS, Attack, GiveUp
from lemma.audit.run import audit_instance
from lemma.audit.skill_trial import SkillTrial
from lemma.core.poses import Pose2
from lemma.tasks.suite import load_instance


def set_down_near(trial: SkillTrial) -> None:
    """Carry each cube towards its goal, to the edge of reach."""
    base, reach = trial.placement.base, trial.reach
    if all(trial.margin(trial.pose(on.top)) <= 0.0 for on in trial.goal.conjuncts):
        raise GiveUp
    for on in trial.goal.conjuncts:
        top, bottom = trial.pose(on.top), trial.pose(on.bottom)
        bearing = math.atan2(bottom.y - base.y, bottom.x - base.x)
        radius = min(trial.radius(bottom), reach.travel_m - 0.001)
        place = Pose2(
            base.x + radius * math.cos(bearing), base.y + radius * math.sin(bearing)
        )
        trial.move(top, place)


ATTACKS.add(
    "set_down_near",
    Attack(
        name="set_down_near",
        summary="Sets every cube down as near to its goal as the arm allows.",
        level="skill",
        play=set_down_near,
        cheap=True,
    ),
)

if __name__ == "__main__":
    for index in range(3):
        instance = load_instance("pass", "test", index)
        for found in audit_instance(instance, ["set_down_near"]):
            print(instance.key, "solved" if found.succeeded else "not solved")
