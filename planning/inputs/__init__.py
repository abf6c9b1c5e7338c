"""What a plan is made from: assets, given poses, a calibration, missed labels; and what `hulldown inspect` shows."""
