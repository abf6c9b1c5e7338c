"""What a plan is made from: assets, given poses, and a calibration; and what `hulldown inspect` shows."""
