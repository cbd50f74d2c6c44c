"""Two public data sets of R, with what pingouin 0.7.0 (and R, where it is named) makes of them.

PlantGrowth: Dobson, An Introduction to Statistical Modelling (1983), dried weight of plants. InsectSprays: Beall,
Biometrika 32 (1942), insects counted after six sprays. `pingouin.welch_anova` and `pingouin.pairwise_gameshowell`
printed the numbers; R's `oneway.test` prints the same F, degrees of freedom and p in its five digits.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class PublicGroups:
    """Samples by group; F, second degrees of freedom and p of Welch's test; p of some pairs by Games and Howell."""

    samples: dict[str, list[float]]
    f: float
    df_within: float
    p: float
    pairs: dict[tuple[str, str], float]


PLANT_GROWTH = PublicGroups(
    {
        "ctrl": [4.17, 5.58, 5.18, 6.11, 4.50, 4.61, 5.17, 4.53, 5.33, 5.14],
        "trt1": [4.81, 4.17, 4.41, 3.59, 5.87, 3.83, 6.03, 4.89, 4.32, 4.69],
        "trt2": [6.31, 5.12, 5.54, 5.50, 5.37, 5.29, 4.92, 6.15, 5.80, 5.26],
    },
    5.18097240811319,
    17.12841861664413,
    0.017392821490169984,
    {("ctrl", "trt1"): 0.4745549222, ("ctrl", "trt2"): 0.1128891769, ("trt1", "trt2"): 0.0237034547},
)
INSECT_SPRAYS = PublicGroups(
    {
        "A": [10, 7, 20, 14, 14, 12, 10, 23, 17, 20, 14, 13],
        "B": [11, 17, 21, 11, 16, 14, 17, 17, 19, 21, 7, 13],
        "C": [0, 1, 7, 2, 3, 1, 2, 1, 3, 0, 1, 4],
        "D": [3, 5, 12, 6, 4, 3, 5, 5, 5, 5, 2, 4],
        "E": [3, 5, 3, 5, 3, 6, 1, 1, 3, 2, 6, 4],
        "F": [11, 9, 15, 22, 15, 16, 13, 10, 26, 26, 24, 13],
    },
    36.06544389357725,
    30.04256050876738,
    7.999379455673353e-12,
    {("A", "B"): 0.9972482341, ("A", "D"): 0.0001255901, ("C", "D"): 0.0556677695, ("D", "E"): 0.6005952535},
)
PUBLIC = {"PlantGrowth": PLANT_GROWTH, "InsectSprays": INSECT_SPRAYS}
