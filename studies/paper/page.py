"""What the page of the paper's study says besides its numbers."""

INTRODUCTION = """\
Made by `python paper_tables.py` from the episodes in [record](record); changes by hand are
lost at the next run. `python paper_tables.py --run` runs what is missing first.
"""

READING = """\
## How to read this

- The paper's scenarios are not published: neither its arenas, robot, crowds and speeds nor its
  weights. Ours are in [scenarios](../scenarios), so orders of methods tell more than values. The
  paper's numbers are shown beside ours and used for nothing else.
- Every method meets the same pedestrians on seeds 0 to 499, or 0 to 99 for planners that plan anew
  at every step. Intervals are 95 %, tests are paired permutation tests, corrected after Holm:
  [docs/metrics.md](../docs/metrics.md).
- Straight line is the floor. Informed knows all positions, speeds and intentions: the ceiling.
- The paper timed inference on a GPU, we on the processor named below, one thread per planner:
  times are shown and not judged.
- The episodes are of world 0.2, which rounds the same on every processor. 15,080 were run again for
  it; of the 33,820 others it was shown that they are what they were
  ([docs/decisions.md](../docs/decisions.md)).
- Ours and the TD-MPC-style planner search as their weights say, with fewer candidates than in the
  paper and another score ([docs/decisions_agents.md](../docs/decisions_agents.md)); cards of the
  learned agents are in [agents](../agents).
"""
