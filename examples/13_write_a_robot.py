"""A new arm, a UR16e, and a task for a team with it.

python examples/13_write_a_robot.py [SEED]
"""

import sys
from dataclasses import replace

import lemma

lemma.ARMS.add(
    "ur16e",
    lemma.ArmSpec(
        name="ur16e",
        d1=0.1807,
        a2=0.4784,
        a3=0.36,
        d4=0.17415,
        d5=0.11985,
        d6=0.11655,
        shoulder_offset=0.176,
        elbow_offset=-0.137,
        link_masses=(7.369, 10.45, 4.321, 2.18, 2.033, 0.907),
        effort_limits=(330.0, 330.0, 150.0, 56.0, 56.0, 56.0),
        velocity_limits=(2.09, 2.09, 3.14, 3.14, 3.14, 3.14),
        payload_kg=16.0,
        shoulder_radius=0.078,
        elbow_radius=0.065,
        wrist_radius=0.048,
        upper_tube_radius=0.056,
        forearm_tube_radius=0.043,
        stiffness=(60000.0, 60000.0, 30000.0, 6000.0, 6000.0, 6000.0),
        lag_s=0.028,
        armature=(9.4, 9.4, 4.7, 0.94, 0.94, 0.94),
    ),
)

lemma.TASKS.add(
    "stack_ur16e",
    replace(lemma.TASKS["stack"], name="stack_ur16e", teams=(("ur16e", "ur5"),)),
)

if __name__ == "__main__":
    seed = int(sys.argv[1]) if len(sys.argv) > 1 else 0
    env = lemma.make("stack_ur16e", level="plan", index=seed)
    expert = lemma.ExpertPolicy(env)
    observation, info = env.reset()
    print(f"{info['instruction']} ({env.instance.team})")
    done = False
    while not done:
        action = expert.act(observation)
        observation, reward, terminated, truncated, info = env.step(action)
        done = terminated or truncated
    print(f"{'success' if reward else 'failure'} after {info['elapsed_s']:.1f} s")
    sys.exit(reward != 1.0)
