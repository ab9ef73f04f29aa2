"""The paper's study: "Predictive Local Planning with Multi-Step Reward and Q-Value Forecasting".

Its Tables I to VII, its figures and what its text claims, on our scenarios.
"""

from crowdbench_studies.paper.claims import CLAIMS
from crowdbench_studies.paper.figures import DRAWINGS
from crowdbench_studies.paper.page import INTRODUCTION, READING
from crowdbench_studies.paper.plan import MORE, TABLES

from crowdbench.study import Study

STUDY = Study(
    name="paper",
    title="Results",
    tables=TABLES,
    claims=CLAIMS,
    figures=DRAWINGS,
    more=MORE,
    source="the paper",
    introduction=INTRODUCTION,
    reading=READING,
    shown=("I", "VII", "figure_4_corridors"),
)
