"""Colours (red, green, blue) of what is drawn into the pictures of an insertion; Okabe and Ito, as in the figures."""

OBSTACLE = (213, 94, 0)
TARGET = (0, 158, 115)
PLAN = (255, 166, 0)
TAKEN = (86, 180, 233)
