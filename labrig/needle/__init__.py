"""needle: what the needle is: hinge design, reach, kinematics of arcs.

Decided here:

- **Configurations are arrays (..., n, 2)**, columns (theta, delta) as in the paper's psi, and every function of the
  kinematics takes any number of leading axes: a thousand paths cost little more than one.
- **Where the paper misprints, the correction is implemented and cited** at the equation.
"""

from labrig.needle.kinematics import (
    Frames,
    arc_jacobian,
    arc_pose,
    control_jacobians,
    control_points,
    cross_matrix,
    path_frames,
    path_jacobian,
    path_points,
    rotation_x,
    rotation_z,
)

__all__ = [
    "Frames",
    "arc_jacobian",
    "arc_pose",
    "control_jacobians",
    "control_points",
    "cross_matrix",
    "path_frames",
    "path_jacobian",
    "path_points",
    "rotation_x",
    "rotation_z",
]
