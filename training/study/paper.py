"""The paper's figures, for comparison with a study's: sections 3 and 4, Figures 5 to 9.

The text has counts at 100 % and rounded shares elsewhere. Values that it doesn't have are None.
"""

from __future__ import annotations

LABELS = 1079  # of its 320 test photographs: 688 found and 391 missed
PHOTOGRAPHS = 420

# Fraction -> arm -> figures in the text.
PAPER: dict[float, dict[str, dict[str, float | None]]] = {
    0.05: {
        "real": {"tp": 210, "precision": 0.88, "recall": 0.20, "f1": 0.32},
        "mixed": {"tp": 450, "precision": 0.91, "recall": 0.41, "f1": 0.57},
    },
    0.1: {
        "real": {"precision": 0.81, "recall": 0.23, "f1": 0.35},
        "mixed": {"precision": 0.86, "recall": 0.38, "f1": 0.53},
    },
    0.25: {
        "real": {"precision": 0.95, "recall": 0.55, "f1": 0.70},
        "mixed": {"precision": 0.88, "recall": 0.74, "f1": 0.80},
    },
    0.5: {
        "real": {"precision": 0.98, "recall": 0.47, "f1": 0.64},
        "mixed": {"precision": 0.96, "recall": 0.53, "f1": 0.69},
    },
    1.0: {
        "real": {"tp": 688, "fp": 49, "fn": 391, "precision": 0.93, "recall": 0.64, "f1": 0.76},
        "mixed": {"tp": 521, "fp": 15, "fn": 558, "precision": 0.97, "recall": 0.48, "f1": 0.65},
    },
}


def paper_figure(fraction: float, arm: str, measure: str) -> float | None:
    """The paper's figure of an arm at a fraction; None if it has none."""
    return PAPER.get(fraction, {}).get(arm, {}).get(measure)
