"""needle: what the needle is: hinge design, reach, kinematics of arcs.

A needle's tip is a row of links cut from a tube, each hinged to the next about a pin square to that of the
hinge before it. The bevel drives the hinges to their stops, and the tip becomes an arc of radius r. Two
adjacent hinges turn by beta_rot together: r = 2 H / beta_rot (equation 1), beta_rot = beta_a + beta_b
(equation 2). This room computes what to cut for a radius in two ways: by equation (3) of the paper, and by a search
on a contour of our own, because figure 2 is not in the paper's text.

Angles of hinges are degrees, as in equation (3) and table I, and names say so; angles of arcs are rad; lengths are mm.

What is decided here:

- **How hinge b counts.** The pins of a pair are orthogonal. In a plane of bending hinge a turns about its pin.
  Hinge b is seen square to its pin and turns as far as its clearance allows. This is how we read "the clearance
  cannot be ignored. As a result, beta_rot is contributed by the rotations of both". It explains equation
  (3): the inclination counts about once (1.09), the clearance for both hinges.
- **The contour** is drawn in `hinge.py`, with every choice that was free. Its proportions are round numbers. Which
  link carries the inclination, and on which side of the line the kerf falls, was chosen with equation (3) in view:
  with the inclination on the knuckle link the plane is about 1.00, 325 and -0.2, with the kerf shared by both links
  about 1.19, 390 and -1.4. So the agreement of the slope with beta_cut is not evidence that the paper's contour is
  like ours.
- **What it reproduces.** On 7 x 7 points, d from 0.010 to 0.040 mm and beta_cut from 0 to 8 degrees, the plane
  is beta_rot = 1.10 beta_cut + 341 d - 0.67 with an RMSE of 0.13 degrees; the paper's is 1.09 beta_cut + 296 d -
  0.433 with 0.1608. So the form, the slope with beta_cut, and the sign and order of the intercept agree. The last two
  have one cause: the stop is drawn by a turn about the pin, which shortens the lips, so clearance and inclination
  multiply.
- **What it does not.** The slope with d is 15 % too steep. For the paper's needle (30 mm at 0.025 mm) our contour
  asks for 3.33 degrees, equation (3) for 4.12, and the paper's cut turns 12.3 degrees on our contour instead of
  11.46. The measured 27.6 mm correspond to 12.46 degrees; nothing follows from that. Play d to both sides and
  stops at D_o / 2 give 2 d / (D_o / 2) for hinge a and 2 d / D_o for b, 286 degrees per mm; the round lips
  give the rest, because they hold the knuckle at a slant. The range of the paper's figure 3 is not in its
  text; ours is a choice. Nobody should cut by our contour, so no cutting file is written.
- **Code that needs a radius** and not a hinge reads a design file (`labrig.protocol.load_design`). Its tolerance is a
  worst case, low to high, not a standard deviation. The file states whether the radius comes from equation (3), for a
  tube of the paper's section, or from our contour, for any other tube.
- **Configurations are arrays (..., n, 2)**, columns (theta, delta) as in the paper's psi, and every function of the
  kinematics takes any number of leading axes: a thousand paths cost little more than one.
- **If the paper has a misprint, the correction is implemented and cited** at the equation.
- **Limits**: the links are rigid, the kerf is the same all along the cut, and the laser cuts along the pin.
"""
