"""simulation: the world behind the simulated devices: gel, needle, sheath, light and lens; it imports no device.

What is decided here
--------------------
- The world shares no model with the code that measures it: it has its own projection, path and frames, so that it
  can contradict `vision`. import-linter forbids the import.
- Every draw depends on the seed and its purpose (specimen, hole, needle, picture of the hole), never on earlier
  draws: hole 7 has the same radius whether or not holes 0 to 6 were used.
- Frames are those of the steering plane: z along the insertion (right in the picture), y up, x away from the
  camera. The origin is seen at `lens.origin_px`; the sheath's tip is there, apart from the sheath's play,
  when the linear axis is at `sheath_tip_at_origin_linear_mm`. At linear axis 0 it touches the gel's surface.
- A needle of a known design draws its radius once, uniformly within the design's tolerance, by seed and needle_id; the
  gels' radii, which apply to the paper's needle, are scaled by it over 30 mm. The hinges themselves are not simulated.
- A phantom is a block with obstacles cast in, for one insertion. Unless the description states otherwise, only there
  is the path disturbed: the curvature wanders, the tip turns by itself, in cavities it goes straight, the tip lags
  behind the insertion, and layers have other radii. Its obstacles may lie beside where the protocol says, and its
  target may move; printed markers move with the target, and obstacles stay.
- The bevel follows the rotation axis with play (`track`): as far as friction along the needle can wind it up. The
  wind-up stays while the needle advances without turning, and while it waits.
- The path is computed in space: at a roll other than 0 and pi, or behind a sheath that leans, it leaves the plane. The
  picture shows it where its rays meet the plane, and as wide as its distance makes it (`lens`). The same holds for
  its cut, the sheath and obstacles.
- The tip is the end of the centre line, level with the foremost point of the bevel.
- Not simulated: refraction (graph paper and needle lie in the same plane under the same gel, so a plane map
  made from the paper holds for the needle), depth of field, motion blur, and
  forces of the gel: the axes move as in air.
"""
