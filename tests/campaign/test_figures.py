"""Figures of a campaign: what is drawn where."""

import numpy as np

from labrig.campaign.figures import bin_share


def test_the_share_of_a_field_stands_where_its_points_are() -> None:
    """Rows go along y: what reaches the target with a large x and a small y is right below, not left above."""
    x, y = (each.ravel() for each in np.meshgrid(np.linspace(0, 1, 10), np.linspace(0, 1, 10)))
    share, x_edges, y_edges = bin_share(x, y, (x > 0.5) & (y < 0.5))
    assert share.shape == (len(y_edges) - 1, len(x_edges) - 1)
    assert (share[0, -1], share[-1, 0]) == (1.0, 0.0)
