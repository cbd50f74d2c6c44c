"""geometry: frames, signs, units and symbols; and the circle through points.

This is the one page of conventions. Every other room follows it and repeats none of it.

**Units.** Lengths are mm, angles rad, times s, and names end in the unit (`radius_mm`, `t_s`) wherever a
number could be of another one. `fit_circle` takes points of any unit and answers in the same, so it names
none. Degrees appear in text for people only. What is unknown, refused or infinite is `None` in Python and
`null` in JSON, never a magic number.

**Pixels.** Arrays (N, 2) with columns (u, v): u right, v down, the centre of the first pixel at (0, 0), so a
picture of width w covers u from -0.5 to w - 0.5. Pictures are uint8, (H, W) grey or (H, W, 3) blue-green-red.

**Steering plane frame.** Right-handed: z along the insertion, x away from the camera, y lateral. Points in
the plane are arrays (N, 2) with columns (y, z) in mm. Origin and direction are fixed by the plane
calibration:

=========== ============= =============
insertion   +z is picture +y is picture
=========== ============= =============
``right``   right         up
``down``    down          right
``left``    left          down
``up``      up            left
=========== ============= =============

**Poses.** `T_a_b` takes coordinates in frame b to frame a, so that the names chain: `T_a_c = T_a_b @ T_b_c`.
Rotations are right-handed.

**Signs.** A heading is the angle of the needle's tangent from +z towards +y. The bevel roll delta of the
paper turns about +z; with delta = 0 the needle bends towards -y, with delta = pi towards +y (equation 5). A
radius is positive; the curvature kappa = 1 / r [1/mm] carries a sign where the text says so.

**Symbols of the paper** (Chen, Yang, Liu and Xu, "Design and kinematic modeling of a novel steerable needle
for image-guided insertion") and our names: r `radius_mm`; L_i `length_mm`; theta_i = L_i / r `angle_rad`
(equation 4); delta_i `roll_rad`; D_o `diameter_mm` of a needle; beta_cut and beta_rot the hinge's cutting and
rotating angles (equations 1 to 3); {w} the world frame, {ib}, {ic} and {ie} the base, bending and tip frames
of the i-th arc.
"""

from labrig.geometry.circle import fit_circle

__all__ = ["fit_circle"]
