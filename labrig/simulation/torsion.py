"""Torsion between the base of the needle, which the drive turns, and its bevel: friction, not delay.

Friction along the needle holds the bevel until the base has wound it up, so that the bevel stays behind by a lag in
either direction, however long one waits (Reed, Okamura and Cowan 2009, IEEE Trans. Biomed. Eng. 56(12)).
"""


def follow_with_play(bevel_rad: float, base_rad: float, lag_rad: float) -> float:
    """Return the bevel's angle after the base has turned, by the play operator: never further away than the lag.

    Parameters
    ----------
    bevel_rad : float
        Angle of the bevel before.
    base_rad : float
        Angle of the base now.
    lag_rad : float
        By how much the bevel can be behind, in each direction.
    """
    return min(max(bevel_rad, base_rad - lag_rad), base_rad + lag_rad)
