"""An experiment, a drive and a camera that a lab adds to labrig."""
