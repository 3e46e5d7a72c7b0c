"""Scenes in: keyframes with their camera views, whatever data set they come from."""
