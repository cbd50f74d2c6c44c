"""library: what a notebook and the commands call: the door, and what it needs of files that people name."""
