"""geometry: frames, signs, units and symbols; fits of circles and arcs to points.

This docstring is the one page of conventions. Every room follows it, and none repeats it.

**Units.** Lengths are mm, angles rad, times s. A name ends in its unit (`radius_mm`, `t_s`) wherever the number
could have another one; pixels are `_px`. A ratio has no suffix. Fits in this room take points in any unit and
answer in the same one, so their names carry none. Degrees are for people (messages, options) and for the angles of
hinges, which the paper gives in degrees; such names end in `_deg`. An unknown, refused or infinite value is `None`
in Python and `null` in JSON, never a magic number.

**Pixels.** Points are arrays (N, 2) with columns (u, v): u to the right, v down. The centre of the first pixel is
(0, 0), so a picture of width w covers u from -0.5 to w - 0.5. Pictures are uint8 arrays, (H, W) grey or (H, W, 3)
in the order blue, green, red. An ideal pixel is where the same camera matrix would put the point through a lens
without distortion. The camera frame has x along u, y along v, and z away from the camera.

**Steering plane frame.** Right-handed: z along the insertion, y lateral in the plane, x away from the camera.
Points in the plane are arrays (N, 2) with columns (y, z) [mm]. The plane calibration fixes the origin (a pixel of
the picture) and the direction of the insertion:

=========== ============= =============
insertion   +z is picture +y is picture
=========== ============= =============
``right``   right         up
``down``    down          right
``left``    left          down
``up``      up            left
=========== ============= =============

The world frame {w} of the planner and the estimator is this frame in space: points (N, 3) with columns (x, y, z).

**Poses.** `T_a_b` takes coordinates in frame b to frame a, so that the names chain: `T_a_c = T_a_b @ T_b_c`. It is
4 x 4, its rotation `R_a_b` 3 x 3. A homography is 3 x 3 and takes homogeneous (u, v, 1) of ideal pixels to
(y, z, 1). Rotations follow the right-hand rule.

**Signs.** A heading is the angle of the needle's tangent in the plane, from +z towards +y. The bevel roll delta of
the paper turns about +z. At delta = 0 the needle bends towards -y, at delta = pi towards +y (equation 5). The roll
zero is the position of the rotation axis at which delta = 0. A radius is positive. The curvature is
kappa = 1 / r [1/mm]; where it is signed, as in a fit of arcs, positive bends towards +y: the heading grows along
the arc. Arc length starts at zero at the sheath's tip, or where the needle enters the picture, and grows towards
the needle's tip.

**Uncertainty.** `sigma` and `sd` name a standard deviation, `ci95` a 95 % interval (low, high), `rms` a root mean
square.
NIS and NEES are the normalised squares of innovation and estimation error.

**Symbols of the paper** (Chen, Yang, Liu and Xu, "Design and kinematic modeling of a novel steerable needle for
image-guided insertion") and our names for them:

=================== ======================== ===================================================
paper               labrig                   meaning
=================== ======================== ===================================================
r                   `radius_mm`              steering radius
H                   `link_length_mm`         length of a link (equation 1)
D_o                 `outer_diameter_mm`      outer diameter of the tube
d                   `clearance_mm`           laser clearance of a hinge
beta_cut, beta_rot  `beta_..._deg`           inclination of the cut, rotation of two hinges (1 to 3)
L_i                 `length_mm`              length of the i-th arc
theta_i             `angle_rad`              angle of the i-th arc, L_i / r (equation 4)
delta_i             `roll_rad`               bevel roll before the i-th arc, relative to {ib}
psi                 `psi`                    configuration: rows (theta_i, delta_i)
dl                  `step_mm`                advance between two observations
{w}, {t}            `T_w_t`                  world frame, frame of the tip
{ib}, {ic}, {ie}                             base, bending and end frame of the i-th arc; {ie} is {(i+1)b}
=================== ======================== ===================================================
"""

from labrig.geometry.circle import fit_circle

__all__ = ["fit_circle"]
