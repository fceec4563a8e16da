"""A new attack: put every cube as near to its goal as one arm can.

lemma --plugin examples/14_write_an_attack.py audit --attacks set_down_near
"""

from lemma.audit.attack import attack
from lemma.audit.run import audit_instance
from lemma.audit.skill_trial import SkillTrial
from lemma.tasks.suite import load_instance


@attack("skill", cheap=True)
def set_down_near(trial: SkillTrial) -> None:
    """Sets every cube down as near to its goal as the arm allows."""
    goal = trial.goal.conjuncts
    trial.require(any(trial.margin(trial.pose(on.top)) > 0.0 for on in goal))
    for on in goal:
        bottom = trial.pose(on.bottom)
        radius_m = min(trial.radius(bottom), trial.reach.travel_m - 0.001)
        trial.move(trial.pose(on.top), trial.at(radius_m, trial.outward(bottom)))


if __name__ == "__main__":
    for index in range(3):
        instance = load_instance("pass", "test", index)
        for found in audit_instance(instance, ["set_down_near"]):
            print(instance.key, "solved" if found.succeeded else "not solved")
