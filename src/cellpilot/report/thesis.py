"""Published numbers of the thesis, by scenario: Tables 5.1 to 5.3."""

from typing import Any

PUBLISHED: dict[str, dict[str, dict[str, Any]]] = {
    "thesis-2d": {
        "thesis: DDQN-HER": {"low_sinr_share": 0.0340, "path_ratio_p90": 2.00, "reached_share": 0.9982},
        "thesis: baseline": {"low_sinr_share": 0.1348, "path_ratio_p90": 1.00, "reached_share": 1.0},
    },
    "thesis-2d-noise": {
        "thesis: DDQN-HER": {"low_sinr_share": 0.0587, "path_ratio_p90": 1.89, "reached_share": 1.0},
        "thesis: baseline": {"low_sinr_share": 0.1533, "path_ratio_p90": 1.00, "reached_share": 1.0},
    },
    "thesis-3d": {
        "thesis: DDQN-HER": {"low_sinr_share": 0.1844, "path_ratio_p90": 2.11, "reached_share": 1.0},
        "thesis: baseline": {"low_sinr_share": 0.7521, "path_ratio_p90": 1.00, "reached_share": 1.0},
    },
}

PUBLISHED_IN = {
    "thesis-2d": "Table 5.1",
    "thesis-2d-noise": "Table 5.2",
    "thesis-3d": "Table 5.3 (its text gives 2.19 for the path ratio p90 where the table has 2.11)",
}
