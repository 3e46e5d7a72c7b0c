"""Scenes in: keyframes with six cameras, calibration, ego pose and the recorded path."""
