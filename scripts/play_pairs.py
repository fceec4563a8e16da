"""Print a policy's results on pairs of a feasible and an infeasible instance.

    python scripts/play_pairs.py oracle [60]

The second argument is the number of pairs, beginning with the first.
"""

import sys

from lemma.evaluation.run.pairs import play_pairs, rates
from lemma.tasks.teams.pairs import TEST_PAIRS

if __name__ == "__main__":
    policy, *more = sys.argv[1:]
    played = []
    for one in play_pairs(policy, range(int(more[0]) if more else TEST_PAIRS)):
        played.append(one)
        print(f"{one.index}: {'right' if one.right else 'wrong'}. {one.reason}")
    shares = rates(played)
    print(", ".join(f"{name} {share:.1%}" for name, share in shares.items()))
