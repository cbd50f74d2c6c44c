"""Tables for people: a column for each part of a vector, interval or budget, and cells that no spreadsheet computes."""

import pandas as pd
import pytest

from labrig.record.tables import escape_formula, split_vectors, unescape_formula


def test_vectors_intervals_and_budgets_are_taken_apart() -> None:
    """A list of another length, of words or of several lengths stays as it is; what is not known is empty."""
    table = pd.DataFrame({
        "tip_mm": [[1.0, 2.0], None], "centre_mm": [[1.0, 2.0, 3.0]] * 2, "error_interval_mm": [None, None],
        "radius_ci95_mm": [[1.0, 2.0], None], "names": [["a", "b"]] * 2, "path_mm": [[1.0, 2.0], [1.0, 2.0, 3.0]],
        "radius_budget_mm": [{"lens": 0.1, "fit": None}, None], "other_budget_mm": [None, None],
        "where": [{"lens": 0.1}] * 2, "n": [1, 2], "tip_px": [[3.0, 4.0]] * 2,
    })  # fmt: skip
    apart = split_vectors(table)
    assert list(apart.columns) == [
        "tip_y_mm", "tip_z_mm", "centre_x_mm", "centre_y_mm", "centre_z_mm", "error_low_mm", "error_high_mm",
        "radius_ci95_low_mm", "radius_ci95_high_mm", "names", "path_mm",
        "sigma_radius_lens_mm", "sigma_radius_fit_mm", "other_budget_mm", "where", "n", "tip_u_px", "tip_v_px",
    ]  # fmt: skip
    for name, value in (("tip_z_mm", 2.0), ("radius_ci95_low_mm", 1.0), ("sigma_radius_lens_mm", 0.1)):
        assert apart[name].tolist()[0] == value
        assert apart[name].isna().tolist() == [False, True]
    assert apart["sigma_radius_fit_mm"].isna().all()


@pytest.mark.parametrize(
    ("value", "cell"),
    [("=1+1", "'=1+1"), ("-y", "'-y"), ("@a", "'@a"), ("-1.5", "-1.5"), ("-1; +2e-3",) * 2, (-1.5, -1.5), ("a", "a")],
)  # fmt: skip
def test_a_text_that_a_spreadsheet_would_compute_gets_an_apostrophe(value: object, cell: object) -> None:
    """Numbers stay, also several, and every text comes back."""
    assert escape_formula(value) == cell
    assert not isinstance(cell, str) or unescape_formula(cell) == value
