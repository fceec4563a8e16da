"""The expert as a policy: a loop of three lines solves a task.

python examples/02_expert.py [TASK] [INDEX]
"""

import sys

import lemma

task = sys.argv[1] if len(sys.argv) > 1 else "hook"
index = int(sys.argv[2]) if len(sys.argv) > 2 else 0

env = lemma.make(task, level="plan", split="test", index=index)
expert = lemma.ExpertPolicy(env)
observation, info = env.reset()
print(info["instruction"])

done = False
while not done:
    action = expert.act(observation)
    observation, reward, terminated, truncated, info = env.step(action)
    done = terminated or truncated
    print(f"{info['elapsed_s']:6.2f} s  {env.decode(action)}: {info['outcome']}")

print("success" if info["is_success"] else f"failed: {info['failure']}")
sys.exit(not info["is_success"])
